"""Measured recordings: reading log files and turning them into datasets."""

from noiseid_cli.recordings.importing import import_recordings
from noiseid_cli.recordings.options import ColumnMap, Decimation, ProblemPolicy, RecordingSource, TimeMap
from noiseid_cli.recordings.readers import read_table, source_digest

__all__ = [
    "ColumnMap",
    "Decimation",
    "ProblemPolicy",
    "RecordingSource",
    "TimeMap",
    "import_recordings",
    "read_table",
    "source_digest",
]

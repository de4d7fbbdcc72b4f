"""One way to read a log file, whatever its format."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

from noiseid_cli.errors import DataError
from noiseid_cli.recordings.binary import list_binary, read_binary
from noiseid_cli.recordings.delimited import list_delimited, read_delimited
from noiseid_cli.recordings.options import Kind, RecordingSource
from noiseid_cli.recordings.table import Key, Table, checked_bytes

_KINDS: dict[str, Kind] = {
    ".csv": "csv", ".txt": "csv", ".tsv": "csv", ".dat": "csv", ".log": "csv", ".asc": "csv",
    ".mat": "mat", ".h5": "hdf5", ".hdf5": "hdf5", ".hdf": "hdf5", ".nc": "hdf5", ".npz": "npz",
}  # fmt: skip


def read_table(source: RecordingSource, wanted: Sequence[Key]) -> Table:
    """Read the wanted columns of a log file.

    Args:
        source: the file and how it is written.
        wanted: columns by name, or by number from 1 in a CSV file.

    Raises:
        DataError: the file cannot be read, or has no such column.
    """
    wanted = list(dict.fromkeys(wanted))
    kind = _kind(source)
    if kind == "csv":
        return read_delimited(source, wanted)
    return read_binary(source, kind, wanted)


def list_columns(source: RecordingSource) -> list[Key]:
    """The columns of a log file that ``read_table`` could be asked for.

    Raises:
        DataError: the file cannot be read.
    """
    kind = _kind(source)
    return list_delimited(source) if kind == "csv" else [*list_binary(source.file, kind)]


def _kind(source: RecordingSource) -> Kind:
    return source.kind or kind_of(source.file, "set its kind in the config (csv, mat, hdf5, npz)")


def kind_of(file: Path, advice: str) -> Kind:
    """The kind of a file by the ending of its name.

    Raises:
        DataError: the ending is not known; with advice on what to do.
    """
    kind = _KINDS.get(file.suffix.lower())
    if kind is None:
        raise DataError(f"{file}: its name does not tell what kind of file it is; {advice}.")
    return kind


def source_digest(file: Path) -> str:
    """SHA-256 of a log file, as hexadecimal digits, to be kept with what is made of it.

    Raises:
        DataError: the file cannot be read.
    """
    return hashlib.sha256(checked_bytes(Path(file))).hexdigest()

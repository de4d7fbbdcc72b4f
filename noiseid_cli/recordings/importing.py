"""Log files become a dataset: every fault is found first and told with its row, or dealt with as the config says."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from noiseid_cli.errors import DataError
from noiseid_cli.models.recording import Dataset, Recording
from noiseid_cli.recordings.cells import Series, make_series
from noiseid_cli.recordings.clock import bridge_gaps, even_intervals, nominal_interval, order_stamps
from noiseid_cli.recordings.decimation import decimate
from noiseid_cli.recordings.faults import Findings, counted
from noiseid_cli.recordings.merging import merge
from noiseid_cli.recordings.options import ColumnMap, Decimation, ProblemPolicy, RecordingSource
from noiseid_cli.recordings.readers import read_table

Quantities = tuple[tuple[str, str, str], ...]


def import_recordings(
    name: str,
    sources: Sequence[RecordingSource],
    policy: ProblemPolicy,
    model_name: str,
    input_quantities: Quantities,
    output_quantities: Quantities,
    decimation: Decimation | None = None,
) -> Dataset:
    """Make one dataset of log files.

    Args:
        name: label of the dataset.
        sources: the files and their columns; each becomes a test, or several where it is split at gaps.
        policy: what to do about faults.
        model_name: name of the model.
        input_quantities, output_quantities: (name, unit, description) of the model's inputs and outputs, in order.
        decimation: a longer sample time; None keeps every sample.

    Returns:
        The dataset; its notes say what was done to the data.

    Raises:
        DataError: a file or column cannot be read, or there are faults for which the policy is ``error``.
    """
    if not sources:
        raise DataError(f"Dataset '{name}' names no recordings.")
    _refuse_equal_names(name, [source.name for source in sources])
    findings = Findings()
    recordings: list[Recording] = []
    for given in sources:
        source = _checked(given, model_name, input_quantities, output_quantities)
        main, *others = (order_stamps(_series(s, policy, findings), policy, findings) for s in (source, *source.also))
        if others:
            main = merge(main, others, [quantity[0] for quantity in output_quantities], findings)
        recordings += _recordings(main, policy, findings)
    findings.raise_if_faulty(name)
    if decimation is not None and decimation.factor > 1:
        recordings = [decimate(recording, decimation, findings) for recording in recordings]
    for recording in recordings:
        if recording.samples < 2:
            count = counted(recording.samples, "sample")
            raise DataError(f"Dataset '{name}': test '{recording.name}' has {count}; at least 2 are needed.")
    _refuse_equal_names(name, [recording.name for recording in recordings])
    notes = tuple(findings.notes)
    return Dataset(name, model_name, tuple(recordings), input_quantities, output_quantities, notes=notes)


def _series(source: RecordingSource, policy: ProblemPolicy, findings: Findings) -> Series:
    """The columns of one file."""
    columns = [c.column for c in (*source.inputs.values(), *source.outputs.values())]
    if source.time.column is not None:
        columns.insert(0, source.time.column)
    return make_series(source, read_table(source, columns), policy, findings)


def _recordings(series: Series, policy: ProblemPolicy, findings: Findings) -> list[Recording]:
    """The tests of one series with rising times."""
    if len(series.time) < 2:
        start = float(series.time[0]) if len(series.time) else 0.0
        return [Recording(series.name, np.empty(0), series.u, series.y, start)]
    interval = series.source.time.interval
    nominal = nominal_interval(series, interval, policy)
    tests = []
    for part in bridge_gaps(series, nominal, policy, findings):
        even, dt = even_intervals(part, nominal, policy, findings)
        if interval is not None:
            dt = np.round(dt / interval) * interval  # all rows stand on one grid: no rounding in between
        tests.append(Recording(even.name, dt, even.u, even.y, float(even.time[0])))
    return tests


def _checked(
    source: RecordingSource, model_name: str, input_quantities: Quantities, output_quantities: Quantities
) -> RecordingSource:
    """The source with its columns in the model's order, after its options have been found to make sense."""
    for file in (source, *source.also):
        _check_file(file)
    inputs = _ordered("input", source.inputs, input_quantities, model_name)
    given = [source.outputs, *(other.outputs for other in source.also)]
    twice = {name for k, maps in enumerate(given) for name in maps if any(name in more for more in given[k + 1 :])}
    if twice:
        raise DataError(f"{source.file}: output '{min(twice)}' of test '{source.name}' is taken from two files.")
    together = _ordered("output", {k: m for maps in given for k, m in maps.items()}, output_quantities, model_name)
    own = [{name: m for name, m in together.items() if name in maps} for maps in given]
    also = tuple(replace(other, outputs=maps) for other, maps in zip(source.also, own[1:], strict=True))
    return replace(source, inputs=inputs, outputs=own[0], also=also)


def _check_file(source: RecordingSource) -> None:
    """Refuse a time axis or a range of rows that makes no sense."""
    time = source.time
    if (time.column is None) == (time.interval is None):
        raise DataError(f"{source.file}: time needs either a column or an interval, and not both.")
    if time.interval is not None and not 0.0 < time.interval < float("inf"):
        raise DataError(f"{source.file}: the interval is {time.interval} s; it must be above 0.")
    begin, end = source.rows or (1, None)
    if begin < 1 or (end is not None and end < begin):
        raise DataError(f"{source.file}: rows {begin} to {end} are no range; rows count from 1.")


def _refuse_equal_names(name: str, names: list[str]) -> None:
    for label in names:
        if names.count(label) > 1:
            raise DataError(f"Dataset '{name}': two tests are called '{label}'; give each recording its own name.")


def _ordered(word: str, maps: Mapping[str, ColumnMap], quantities: Quantities, model_name: str) -> dict[str, ColumnMap]:
    """The columns in the model's order; each of its quantities needs one."""
    names = [quantity[0] for quantity in quantities]
    for name in maps:
        if name not in names:
            close = difflib.get_close_matches(name, names, n=1)
            hint = f" Did you mean '{close[0]}'?" if close else ""
            raise DataError(f"The model {model_name} has no {word} '{name}'; it has {', '.join(names)}.{hint}")
    lacking = [name for name in names if name not in maps]
    if lacking:
        raise DataError(
            f"The model {model_name} needs a column for each {word}; none is given for {', '.join(lacking)}."
        )
    return {name: maps[name] for name in names}

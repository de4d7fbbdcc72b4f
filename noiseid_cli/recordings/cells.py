"""From a table to a series of samples: which column is what, and cells that hold no number."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from noiseid_cli.models.recording import Array
from noiseid_cli.recordings.faults import Fault, Findings, counted, places
from noiseid_cli.recordings.options import ProblemPolicy, RecordingSource
from noiseid_cli.recordings.table import Key, Table

Mask = NDArray[np.bool_]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Series:
    """One recording on its way.

    Attributes:
        source: where it comes from.
        name: label of the test.
        time: (N,) s.
        u, y: (N, nu) and (N, ny), in the model's units.
        rows: (N,) row numbers for messages; an inserted row carries that of the row before it.
        row_word: ``line`` or ``row``.
    """

    source: RecordingSource
    name: str
    time: Array
    u: Array
    y: Array
    rows: Indices
    row_word: str

    def keep(self, chosen: Mask | Indices | slice) -> Series:
        """The chosen samples."""
        return replace(self, time=self.time[chosen], u=self.u[chosen], y=self.y[chosen], rows=self.rows[chosen])

    def fault(self, kind: str, k: int, text: str) -> Fault:
        """A fault at sample k."""
        return Fault(kind, self.source.file, f"{self.row_word} {self.rows[k]}", text)

    def at(self, chosen: Mask) -> str:
        """The rows of the chosen samples, in words."""
        return places(self.row_word, self.rows[chosen].tolist())


def make_series(source: RecordingSource, table: Table, policy: ProblemPolicy, findings: Findings) -> Series:
    """Take the columns from a table, in the model's units, and deal with cells that hold no number."""
    count, time = len(table.row_numbers), source.time
    if time.column is None:
        # Numbered before any row is dropped, so that a dropped row leaves its time free.
        stamps = time.offset + float(time.interval or 0.0) * np.arange(count, dtype=np.float64)
    else:
        stamps = _scaled(table.columns[time.column], time.scale, time.offset)
    u, y = (
        np.column_stack([np.empty((count, 0))] + [_scaled(table.columns[c.column], c.scale, c.offset) for c in maps])
        for maps in (source.inputs.values(), source.outputs.values())
    )
    series = Series(source, source.name, stamps, u, y, table.row_numbers, table.row_word)
    hard = _faults_in_needed(series, table)
    soft = _faults_in_outputs(series, table)
    lost = np.zeros(count, dtype=bool)
    lost[list(hard)] = True
    marked = np.zeros(count, dtype=bool)
    marked[list(soft)] = True
    _note_missing(series, lost | marked, findings)
    if policy.non_number == "drop":
        lost |= marked
        if lost.any():
            text = f"{counted(int(lost.sum()), 'row')} without a usable number dropped ({series.at(lost)})"
            findings.notes.append(f"{series.name}: {text}")
        return series.keep(~lost)
    findings.faults += [series.fault("non_number", k, text) for k, texts in sorted(hard.items()) for text in texts]
    if policy.non_number == "error":
        findings.faults += [series.fault("non_number", k, text) for k, texts in sorted(soft.items()) for text in texts]
    elif marked.any():
        cells = sum(len(texts) for texts in soft.values())
        text = f"{counted(cells, 'non-number')} in outputs marked missing ({series.at(marked)})"
        findings.notes.append(f"{series.name}: {text}")
    return series.keep(~lost)  # the time of the others is looked at even if the import will stop


def _scaled(values: Array, scale: float, offset: float) -> Array:
    """The numbers in the model's unit, NaN where that is beyond all floats; left to the bit where nothing is to do."""
    with np.errstate(over="ignore"):
        if scale != 1.0:
            values = scale * values
        if offset != 0.0:
            values = values + offset
    return np.where(np.isfinite(values), values, np.nan)


def _too_large(raw: float) -> str:
    return f"is {raw:g}, which scale and offset carry beyond the largest number"


def _faults_in_needed(series: Series, table: Table) -> dict[int, list[str]]:
    """By sample: rows of the wrong length, and what time or an input has in place of a number."""
    faults: dict[int, list[str]] = {}
    broken = {cell.row for cell in table.bad if cell.column == ""}
    texts = {(cell.row, cell.column): cell.text for cell in table.bad}
    for row in sorted(broken):
        faults.setdefault(row, []).append(texts[row, ""])
    inputs = zip(series.source.inputs.items(), series.u.T, strict=True)
    needed: list[tuple[Key, str, Array]] = [(c.column, f"input '{name}'", values) for (name, c), values in inputs]
    if series.source.time.column is not None:
        needed.insert(0, (series.source.time.column, "the time", series.time))
    for column, label, values in needed:
        for k in np.flatnonzero(np.isnan(values)).tolist():
            if k not in broken:
                text, raw = texts.get((k, column)), float(table.columns[column][k])
                cause = "has no value" if text is None else f"is {text!r}, not a finite number"
                cause = cause if np.isnan(raw) else _too_large(raw)
                faults.setdefault(k, []).append(f"{label} (column {column!r}) {cause}, and it needs one")
    return faults


def _faults_in_outputs(series: Series, table: Table) -> dict[int, list[str]]:
    """By sample: what an output has in place of a number or nothing."""
    faults: dict[int, list[str]] = {}
    names = {c.column: name for name, c in series.source.outputs.items()}
    for cell in table.bad:
        if cell.column in names:
            text = f"output '{names[cell.column]}' (column {cell.column!r}) is {cell.text!r}, not a finite number"
            faults.setdefault(cell.row, []).append(text)
    for (name, c), values in zip(series.source.outputs.items(), series.y.T, strict=True):
        raw = table.columns[c.column]
        for k in np.flatnonzero(np.isnan(values) & ~np.isnan(raw)).tolist():
            text = f"output '{name}' (column {c.column!r}) {_too_large(raw[k])}"
            faults.setdefault(k, []).append(text)
    return faults


def _note_missing(series: Series, faulty: Mask, findings: Findings) -> None:
    """Note how many values of each output are missing from the start, in rows without a fault."""
    for name, values in zip(series.source.outputs, series.y.T, strict=True):
        missing = np.isnan(values) & ~faulty
        if missing.any():
            text = f"{counted(int(missing.sum()), 'value')} of output '{name}' missing ({series.at(missing)})"
            findings.notes.append(f"{series.name}: {text}")

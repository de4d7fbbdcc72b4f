"""A look at a log file whose columns nobody has named yet: what each one holds, in figures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from noiseid_cli.errors import DataError
from noiseid_cli.models.recording import Array
from noiseid_cli.recordings.options import RecordingSource
from noiseid_cli.recordings.readers import list_columns, read_table
from noiseid_cli.recordings.table import Key, Table

LARGEST = 1e100
"""The largest number that is looked at (chosen): squares of much larger ones overflow."""


@dataclass(frozen=True)
class ColumnFacts:
    """One column of a log.

    Attributes:
        key: its name or number.
        values: (N,) numbers; NaN where there is none.
        missing: number of empty cells.
        bad: number of cells that hold something else than a number.
        step: the quantisation step; None where the values show none.
        noise: standard deviation of what is white at high frequency, from third differences.
    """

    key: Key
    values: Array
    missing: int
    bad: int
    step: float | None
    noise: float

    @property
    def constant(self) -> bool:
        """It holds one value, or none."""
        known = self.known
        return not len(known) or bool(np.all(known == known[0]))

    @property
    def known(self) -> Array:
        """The values that are there."""
        return self.values[~np.isnan(self.values)]

    @property
    def held(self) -> float:
        """Share of rows that repeat the value of the row before."""
        return float(np.mean(np.diff(self.known) == 0.0)) if len(self.known) > 1 else 1.0

    @property
    def rounding(self) -> float:
        """Standard deviation of the rounding to its step: step / sqrt(12), that of a uniform error."""
        return (self.step or 0.0) / math.sqrt(12.0)


@dataclass(frozen=True)
class Survey:
    """All columns of one log.

    Attributes:
        source: the file, with the decimal sign that was found.
        table: what was read.
        columns: the facts, in the order of the file.
    """

    source: RecordingSource
    table: Table
    columns: tuple[ColumnFacts, ...]

    def column(self, key: Key) -> ColumnFacts:
        """The facts of one column."""
        return next(column for column in self.columns if column.key == key)

    def find(self, wanted: str) -> Key:
        """The column that the user means: by name, or by number from 1.

        Raises:
            DataError: there is none.
        """
        from noiseid_cli.recordings.table import unknown_column

        keys = [column.key for column in self.columns]
        if wanted in keys:
            return wanted
        if wanted.isdecimal() and int(wanted) in keys:
            return int(wanted)
        raise unknown_column(self.source.file, wanted, [str(key) for key in keys])


def survey(source: RecordingSource) -> Survey:
    """Read every column of a log and take its facts.

    A text table in which commas stand for decimal points is found out as well.

    Raises:
        DataError: the file cannot be read, holds fewer than two rows, or a number whose square would overflow.
    """
    table = read_table(source, list_columns(source))
    if table.row_word == "line" and table.bad:
        other = replace(source, decimal=",")
        again = read_table(other, list_columns(other))
        if len(again.bad) < len(table.bad) and len(again.columns) > 1:
            source, table = other, again
    if len(table.row_numbers) < 2:
        raise DataError(f"{source.file} holds a single data row; expected a recording.")
    for key, values in table.columns.items():
        beyond = np.flatnonzero(np.abs(values) > LARGEST)
        if beyond.size:
            at = f"{table.row_word} {table.row_numbers[beyond[0]]}"
            raise DataError(
                f"{source.file}, {at}: column {key!r} holds {values[beyond[0]]:g}, more than any sensor gives "
                f"({LARGEST:g}): mend the log, or leave the column out of it."
            )
    return Survey(source, table, tuple(_facts(table, key) for key in table.columns))


def _facts(table: Table, key: Key) -> ColumnFacts:
    values = table.columns[key]
    bad = sum(cell.column in (key, "") for cell in table.bad)
    missing = int(np.isnan(values).sum()) - bad
    return ColumnFacts(key, values, missing, bad, quantisation_step(values), high_frequency_std(values))


def quantisation_step(values: Sequence[float] | Array) -> float | None:
    """The step that the differences between neighbouring levels are whole multiples of; None if there is none.

    It is that of the sensor, or of the digits that the log keeps where these are coarser.

    Args:
        values: (N,) numbers, NaN where missing.
    """
    known = np.asarray(values, dtype=float)
    known = known[~np.isnan(known)]
    levels = np.unique(known)
    if len(levels) < 2:
        return None
    gaps = np.diff(levels)
    # Printed digits differ in the last place: levels closer than this are one level.
    gaps = gaps[gaps > 1e-6 * gaps.max()]
    multiples = gaps / gaps.min()
    step = float(np.median(gaps / np.round(multiples)))
    off = np.abs(gaps / step - np.round(gaps / step))
    return step if np.mean(off < 0.05) > 0.95 else None


def high_frequency_std(values: Array) -> float:
    """Standard deviation of white noise on a smooth signal, from its third differences.

    The third difference of white noise of variance s^2 has the variance 20 s^2 (coefficients 1, 3, 3, 1); a signal
    that is a parabola over four samples gives none. The median absolute value keeps jumps out of it.

    Args:
        values: (N,) numbers, NaN where missing.
    """
    third = np.diff(values, 3)
    third = third[~np.isnan(third)]
    normal_median = 0.6745  # median of |z|, z standard normal
    return float(np.median(np.abs(third)) / normal_median / np.sqrt(20.0)) if len(third) else 0.0

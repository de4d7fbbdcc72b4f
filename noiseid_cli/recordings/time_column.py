"""Finding the time column of a log, its unit, and what is wrong with its stamps."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from noiseid_cli.errors import DataError
from noiseid_cli.models.recording import Array
from noiseid_cli.recordings.survey import ColumnFacts, Survey
from noiseid_cli.recordings.table import Key

_UNITS = {"s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "msec": 1e-3, "millis": 1e-3,
          "milliseconds": 1e-3, "us": 1e-6, "usec": 1e-6, "µs": 1e-6, "micros": 1e-6, "microseconds": 1e-6, "ns": 1e-9,
          "nsec": 1e-9, "nanos": 1e-9, "nanoseconds": 1e-9, "min": 60.0, "minutes": 60.0}  # fmt: skip
_WORDS = frozenset({"t", "time", "timestamp", "stamp", "clock", "seconds", "sec", "secs", "ms", "us", "ns"})
SHORTEST, LONGEST = 1e-15, 1e12
"""s between rows that a clock can tell (chosen: a femtosecond to 30 000 years)."""
_EPOCH = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3), (1e8, 1.0))
"""Time since 1970 is about 1.7e9 s: what a number above the first means, in s."""


@dataclass(frozen=True)
class TimeFound:
    """The time axis of a log.

    Attributes:
        key: the column; None where the rows have a fixed interval.
        scale: s per unit of the column.
        interval: s, the median interval, or the fixed one.
        why: how it was found, in a sentence.
        repeated, backward, gaps, unequal: number of stamps with that fault; see ``ProblemPolicy``.
        agree: the rows that repeat a stamp agree in everything else.
        filled: rows that it would take to fill the gaps.
        lost: rows without a usable stamp.
    """

    key: Key | None
    scale: float
    interval: float
    why: str
    repeated: int = 0
    backward: int = 0
    gaps: int = 0
    unequal: int = 0
    agree: bool = True
    filled: int = 0
    lost: int = 0


def words_of(key: Key) -> list[str]:
    """The words of a column's name in lower case, numbers apart: ``pos_meas1`` is pos, meas, 1."""
    split = re.sub(r"([a-z0-9])([A-Z])", r"\1 \2", str(key).rpartition("/")[2]) if isinstance(key, str) else ""
    return re.findall(r"[^\W\d_]+|\d+", split.lower())


def find_time(found: Survey, wanted: Key | None = None, interval: float | None = None) -> TimeFound:
    """The time column of a log: the one that is named so and rises, else one that rises evenly.

    Args:
        found: the columns.
        wanted: the column that the user says is the time.
        interval: s, that the user says is between rows; then no column is taken.

    Raises:
        DataError: there is none, the wanted one does not rise, or no clock ticks as fast or as slowly.
    """
    if interval is not None:
        if not SHORTEST <= interval <= LONGEST:
            raise DataError(f"{interval:g} s between rows: expected {SHORTEST:g} to {LONGEST:g} s.")
        return TimeFound(None, 1.0, interval, "the interval between rows, s, as given")
    if wanted is not None:
        column = found.column(wanted)
        if not _rises(column.values):
            raise DataError(f"{found.source.file}: column {wanted!r} does not rise, so it cannot be the time.")
        return _examined(found, column, "as given")
    rising = [column for column in found.columns if _rises(column.values)]
    named = [column for column in rising if _WORDS & set(words_of(column.key))]
    if named:
        return _examined(found, named[0], "it is named so, and rises")
    even = [column for column in rising if _even(column.values) and not _counts(column.values)]
    if even:
        return _examined(found, even[0], "it rises by nearly the same from row to row")
    raise DataError(
        f"{found.source.file} has no column that looks like the time. Say which one it is with --time COLUMN, or how "
        "far apart the rows are with --interval SECONDS."
    )


def _known(values: Array) -> Array:
    return values[~np.isnan(values)]


def _rises(values: Array) -> bool:
    """All but one step in a hundred go up, and those that go down leave a rise over all."""
    known = _known(values)
    steps = np.diff(known)
    return len(steps) > 0 and float(np.mean(steps > 0.0)) > 0.9 and bool(np.median(steps) > 0.0)


def _even(values: Array) -> bool:
    steps = np.diff(_known(values))
    return bool(np.mean(np.abs(steps - np.median(steps)) < 0.5 * np.median(steps)) > 0.95)


def _counts(values: Array) -> bool:
    """A counter of rows: 0, 1, 2, ... tells no time."""
    return bool(np.all(np.diff(_known(values)) == 1.0))


def _scale(column: ColumnFacts) -> tuple[float, str]:
    """Seconds per unit, and what tells it: the unit in the name, the size of a time since 1970, or of a step."""
    words = words_of(column.key)
    for word in reversed(words[1:] if len(words) > 1 else words):
        if word in _UNITS:
            return _UNITS[word], f"its name says {word}"
    known = _known(column.values)
    for least, scale in _EPOCH:
        if known[0] > least:
            return scale, "as large as a time since 1970 in " + {1.0: "s", 1e-3: "ms", 1e-6: "us", 1e-9: "ns"}[scale]
    step = float(np.median(np.diff(known)))
    if step >= 1.0 and np.all(known == np.round(known)):
        scale = 1e-3 if step < 1e3 else 1e-6 if step < 1e6 else 1e-9
        unit = {1e-3: "ms", 1e-6: "us", 1e-9: "ns"}[scale]
        return scale, f"whole numbers, {step:g} apart: taken for {unit}; set scale if that is wrong"
    return 1.0, "taken for s; set scale if that is wrong"


def _examined(found: Survey, column: ColumnFacts, why: str) -> TimeFound:
    """The column with its unit and the faults of its stamps."""
    scale, unit = _scale(column)
    usable = ~np.isnan(column.values)
    stamps = scale * column.values[usable]
    before = np.concatenate(([-np.inf], np.maximum.accumulate(stamps)[:-1]))
    repeated, backward = stamps == before, stamps < before
    dt = np.diff(stamps[~(repeated | backward)])
    if not len(dt):
        raise DataError(f"{found.source.file}: the time in column {column.key!r} never rises.")
    nominal = float(np.median(dt))
    if not SHORTEST <= nominal <= LONGEST:
        raise DataError(
            f"{found.source.file}: by column {column.key!r} the rows are {nominal:.3g} s apart, so it is no clock. Say "
            "which column is the time with --time COLUMN, or how far apart the rows are with --interval SECONDS."
        )
    gap = dt > 3.0 * nominal
    rows = np.flatnonzero(usable)[repeated]
    others = [other.values for other in found.columns if other.key != column.key]
    return TimeFound(
        column.key,
        scale,
        nominal,
        f"{why}; {unit}",
        repeated=int(repeated.sum()),
        backward=int(backward.sum()),
        gaps=int(gap.sum()),
        unequal=int(np.sum(np.abs(dt - nominal)[~gap] > 0.01 * nominal)),
        agree=all(np.array_equal(v[rows], v[rows - 1], equal_nan=True) for v in others),
        filled=int(np.sum(np.round(dt[gap] / nominal) - 1.0)),
        lost=int(np.sum(~usable)),
    )

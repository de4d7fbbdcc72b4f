"""What the import of measured recordings is told: where the numbers stand, and what to do about faults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

Kind = Literal["csv", "mat", "hdf5", "npz"]


@dataclass(frozen=True)
class ColumnMap:
    """One column of a log file: value in the model's unit = scale * number + offset.

    Attributes:
        column: its name, or its number from 1 in a CSV file. In the other formats ``name`` is a vector or
            ``name[2]`` the second column of a matrix; ``struct.name`` reaches into a MAT struct, ``group/name`` into
            an HDF5 group.
        scale, offset: see above.
    """

    column: str | int
    scale: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class TimeMap:
    """Where time comes from: a column, or a constant interval.

    Attributes:
        column: as in ``ColumnMap``; None if there is none.
        interval: s between rows, where there is no column.
        scale, offset: time in s = scale * number + offset.
    """

    column: str | int | None = None
    interval: float | None = None
    scale: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class RecordingSource:
    """One log file.

    Attributes:
        name: label of the test that it becomes.
        file: the file.
        time: where its time comes from.
        inputs, outputs: the column of each input and output of the model, by its name.
        kind: ``csv``, ``mat``, ``hdf5`` or ``npz``; None goes by the file's name.
        delimiter: character between the fields of a CSV file; `` `` stands for runs of blanks; None finds out.
        header: whether the first row of a CSV file holds names; None finds out.
        comment: what begins a comment line in a CSV file; empty for none.
        decimal: the decimal mark in a CSV file, ``.`` or ``,``.
        rows: first and last data row to take, counted from 1, both included; None as the last takes the rest.
        also: further files of the same test with clocks and outputs of their own, see ``merging``.
    """

    name: str
    file: Path
    time: TimeMap = TimeMap()
    inputs: Mapping[str, ColumnMap] = field(default_factory=dict)
    outputs: Mapping[str, ColumnMap] = field(default_factory=dict)
    kind: Kind | None = None
    delimiter: str | None = None
    header: bool | None = None
    comment: str = "#"
    decimal: Literal[".", ","] = "."
    rows: tuple[int, int | None] | None = None
    also: tuple[RecordingSource, ...] = ()


@dataclass(frozen=True)
class ProblemPolicy:
    """What to do about each kind of fault; ``error`` lists the rows and stops.

    Attributes:
        non_number: text or infinity where a number is needed, an input or time without a value, a row with too
            few or too many fields. ``drop`` the row, or ``mark_missing`` (outputs only).
        repeated_stamp: a row with the time of the one before. ``drop`` it, or ``mark_missing``: keep one row at
            that time, without outputs, since the two disagree.
        backward_stamp: a row with an earlier time than one before it. ``drop`` it.
        gap: an interval above ``gap_factor`` times the nominal one. ``mark_missing`` inserts rows without
            outputs, the input held; ``split`` begins a new test.
        unequal_interval: any other interval that is off the nominal one by more than ``interval_tolerance``
            times it. ``keep`` the intervals as they are, or ``resample`` to equal ones: outputs by linear
            interpolation, inputs held.
        gap_factor, interval_tolerance: see above.
        nominal_interval: s; None takes the median of each recording.
    """

    non_number: Literal["error", "drop", "mark_missing"] = "error"
    repeated_stamp: Literal["error", "drop", "mark_missing"] = "error"
    backward_stamp: Literal["error", "drop"] = "error"
    gap: Literal["error", "mark_missing", "split"] = "error"
    unequal_interval: Literal["error", "resample", "keep"] = "error"
    gap_factor: float = 3.0
    interval_tolerance: float = 0.01
    nominal_interval: float | None = None


@dataclass(frozen=True)
class Decimation:
    """A longer sample time made of the recorded one.

    Attributes:
        factor: one sample is kept of so many; 1 keeps all.
        outputs: ``pick`` the output of every such sample, or ``average`` the outputs of each block.
    """

    factor: int = 1
    outputs: Literal["pick", "average"] = "pick"

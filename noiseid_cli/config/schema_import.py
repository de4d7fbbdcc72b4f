"""The ``import`` section: which files, which columns are time, inputs and outputs, what to do about faults."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, Strict, WithJsonSchema, field_validator, model_validator

from noiseid_cli.config.base import Base, Label, NotNegative, Positive, Text, Whole, WholeFrom2, refuse, unique

_COLUMN_DESCRIPTION = "name of the column (or variable), or its number from 1"


def _column(value: Any) -> Any:
    if isinstance(value, int) and not isinstance(value, bool):
        if value < 1:
            refuse(f"columns are numbered from 1, not {value}")
    elif not (isinstance(value, str) and value):
        refuse("must be the name of a column or its number from 1")
    return value


def _spell(value: Any) -> Any:
    """Take ``mark missing`` and ``mark-missing`` for ``mark_missing``."""
    return value.replace("-", "_").replace(" ", "_") if isinstance(value, str) else value


def _mapping(value: Any) -> Any:
    """Take ``tau1: torque`` for ``tau1: {column: torque}``."""
    return {"column": value} if isinstance(value, str | int) and not isinstance(value, bool) else value


ColumnName = Annotated[
    Any,
    BeforeValidator(_column),
    WithJsonSchema({"anyOf": [{"type": "string", "minLength": 1}, {"type": "integer", "minimum": 1}]}),
]


class Column(Base):
    """A column of the file and how it becomes a value in the model's unit: scale * raw + offset."""

    column: ColumnName = Field(description=_COLUMN_DESCRIPTION)
    scale: float = Field(default=1.0, description="factor to the model's unit; not 0")
    offset: float = Field(default=0.0, description="added after scaling, in the model's unit")

    @field_validator("scale")
    @classmethod
    def _not_zero(cls, value: float) -> float:
        if value == 0.0:
            refuse("must not be 0: that would erase the column")
        return value


Columns = dict[Text, Annotated[Column, BeforeValidator(_mapping, json_schema_input_type=str | int | Column)]]


class Time(Base):
    """The time axis: a column (seconds = scale * raw + offset), or a fixed interval."""

    column: ColumnName | None = Field(default=None, description=_COLUMN_DESCRIPTION)
    scale: Positive = Field(default=1.0, description="factor from the column's unit to s, such as 1e-3 for ms")
    offset: float = Field(default=0.0, description="added after scaling, s")
    interval: Positive | None = Field(
        default=None, description="interval between samples, s, where there is no time column"
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.column is None) == (self.interval is None):
            refuse("give either column or interval")
        if self.interval is not None and self.scale != 1.0:
            refuse("scale goes with column", at=["scale"])
        return self


class Companion(Base):
    """A further file of the same test, with a clock of its own: a slower sensor, say."""

    file: Text = Field(description="the file; a relative path starts at the folder of the experiment file")
    time: Time | None = Field(default=None, description="its time axis, with the same origin; default: the common one")
    outputs: Annotated[Columns, Field(min_length=1)] = Field(
        description="the outputs that it holds; each value goes to the nearest sample of the recording, what lies more "
        "than half an interval off is left out, and samples without a value are missing"
    )


class Source(Base):
    """One recording: a file, and where it differs from the mapping common to all."""

    file: Text = Field(description="the file; a relative path starts at the folder of the experiment file")
    rows: Annotated[tuple[Whole, Whole], Strict(False)] | None = Field(
        default=None,
        description="first and last data row to use, counted from 1, both included; default: all",
    )
    time: Time | None = Field(default=None, description="time axis of this recording; default: the common one")
    inputs: Columns = Field(default={}, description="inputs of this recording that differ from the common ones")
    outputs: Columns = Field(default={}, description="outputs of this recording that differ from the common ones")

    also: Annotated[tuple[Companion, ...], Strict(False)] = Field(
        default=(), description="further files of the same test, with outputs on a clock of their own"
    )

    @field_validator("rows")
    @classmethod
    def _ordered(cls, value: tuple[int, int] | None) -> tuple[int, int] | None:
        if value is not None and not 1 <= value[0] < value[1]:
            refuse(f"must be two row numbers, 1 <= first < last, not {value[0]} and {value[1]}")
        return value


class Format(Base):
    """How the files are to be read, where that cannot be told from them."""

    kind: Literal["csv", "mat", "hdf5", "npz"] | None = Field(
        default=None, description="default: by the ending of the file"
    )
    delimiter: Text | None = Field(
        default=None,
        max_length=1,
        description="csv: the character between columns, a blank for any blanks; default: detected",
    )
    header: bool | None = Field(default=None, description="csv: whether the first row holds names; default: detected")
    comment: Text = Field(default="#", description="csv: what a line to be skipped starts with")
    decimal: Literal[".", ","] = Field(default=".", description="csv: the decimal sign")
    group: Text | None = Field(default=None, description="mat, hdf5: the structure or group that holds the variables")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.delimiter == self.decimal:
            refuse(f"{self.delimiter!r} is the decimal sign already", at=["delimiter"])
        for name in ("delimiter", "header", "comment", "decimal"):
            if self.kind not in (None, "csv") and getattr(self, name) != type(self).model_fields[name].default:
                refuse(f"goes with kind csv, not {self.kind}", at=[name])
        if self.kind in ("csv", "npz") and self.group is not None:
            refuse(f"goes with kind mat or hdf5, not {self.kind}", at=["group"])
        return self


class OnProblem(Base):
    """What to do about each kind of fault in a recording; the default is to stop and say where it is."""

    non_number: Annotated[Literal["error", "drop", "mark_missing"], BeforeValidator(_spell)] = Field(
        default="error", description="an entry that is not a finite number"
    )
    repeated_stamp: Annotated[Literal["error", "drop", "mark_missing"], BeforeValidator(_spell)] = Field(
        default="error", description="a time equal to the one before"
    )
    backward_stamp: Literal["error", "drop"] = Field(default="error", description="a time before the one before")
    gap: Annotated[Literal["error", "mark_missing", "split"], BeforeValidator(_spell)] = Field(
        default="error", description="an interval longer than gap_factor nominal ones"
    )
    unequal_interval: Literal["error", "resample", "keep"] = Field(
        default="error", description="intervals that differ by more than interval_tolerance"
    )


def _factor(value: Any) -> Any:
    """Take ``decimate: 4`` for ``{factor: 4}``."""
    return {"factor": value} if isinstance(value, int | float) and not isinstance(value, bool) else value


class Decimate(Base):
    """A longer sample time: one sample for so many; inputs are averaged over the longer intervals."""

    factor: WholeFrom2 = Field(description="one sample is kept of so many, at least 2")
    outputs: Literal["pick", "average"] = Field(
        default="pick",
        description="pick every such sample, which leaves its noise alone, or average the samples of each block",
    )


class Import(Base):
    """Make datasets from recordings of a real system."""

    recordings: dict[Label, Source] = Field(min_length=1, description="the recordings, each under a name of its own")
    group: Literal["together", "separate"] = Field(
        default="together",
        description="whether the recordings are the tests of one dataset or a dataset each",
    )
    format: Format = Field(default=Format(), description="how to read the files")
    time: Time | None = Field(default=None, description="time axis common to all recordings")
    inputs: Columns = Field(default={}, description="column of each model input, common to all recordings")
    outputs: Columns = Field(default={}, description="column of each model output, common to all recordings")
    decimate: Annotated[Decimate, BeforeValidator(_factor, json_schema_input_type=int | Decimate)] | None = Field(
        default=None, description="a longer sample time: a factor, or {factor, outputs}; inputs are averaged"
    )
    on_problem: OnProblem = Field(default=OnProblem(), description="what to do about faults in the recordings")
    gap_factor: Annotated[float, Field(gt=1)] = Field(
        default=3.0, description="an interval longer than this many nominal ones is a gap, no unit"
    )
    interval_tolerance: NotNegative = Field(
        default=0.01,
        description="relative difference from the nominal interval up to which intervals count as equal",
    )
    nominal_interval: Positive | None = Field(default=None, description="nominal interval, s; default: the median")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if twin := unique(list(self.recordings)):
            refuse("differs from another name in upper and lower case only", at=["recordings", twin])
        for name, source in self.recordings.items():
            if source.time is None and self.time is None:
                refuse("has no time: give a column or an interval, here or for all recordings", at=["recordings", name])
            for i, other in enumerate(source.also):
                if other.time is None and self.time is None:
                    refuse("has no time: give time here or for all", at=["recordings", name, "also", i])
                taken = {*source.outputs, *(more for earlier in source.also[:i] for more in earlier.outputs)}
                if twice := [output for output in other.outputs if output in taken]:
                    refuse(
                        "is taken from another file already", at=["recordings", name, "also", i, "outputs", twice[0]]
                    )
        return self

    def source(self, name: str) -> Source:
        """Give a recording with its time, inputs and outputs complete, the common ones filled in."""
        own = self.recordings[name]
        elsewhere = {output for other in own.also for output in other.outputs}
        common = {output: column for output, column in self.outputs.items() if output not in elsewhere}
        return own.model_copy(
            update={
                "time": own.time or self.time,
                "inputs": {**self.inputs, **own.inputs},
                "outputs": {**common, **own.outputs},
                "also": tuple(other.model_copy(update={"time": other.time or self.time}) for other in own.also),
            }
        )

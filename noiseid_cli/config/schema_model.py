"""The ``model`` section: a model by name, a class in a file, or the matrices of a linear one."""

from __future__ import annotations

import keyword
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, ConfigDict, Field, Strict, WithJsonSchema, model_validator

from noiseid_cli.config.base import Base, Names, Positive, Text, refuse

LETTERS = ("A", "B", "G", "C", "D")
_CELLS = {"anyOf": [{"type": "number"}, {"type": "string"}]}
_ROWS = {"type": "array", "minItems": 1, "items": {"type": "array", "minItems": 1, "items": _CELLS}}


def _matrix(value: Any) -> Any:
    """Take rows of numbers and names, or the name of a CSV file."""
    if isinstance(value, str) and value:
        return value
    rows = value if isinstance(value, list | tuple) else []
    if not rows or not all(isinstance(row, list | tuple) and row for row in rows):
        refuse("must be rows of numbers, such as [[1, 0.1], [0, 1]], or the name of a CSV file that holds them")
    for i, row in enumerate(rows):
        if len(row) != len(rows[0]):
            refuse(f"row {i + 1} has {len(row)} entries, but row 1 has {len(rows[0])}", at=[i])
        for j, entry in enumerate(row):
            name = isinstance(entry, str) and entry.isidentifier() and not keyword.iskeyword(entry)
            number = isinstance(entry, int | float) and not isinstance(entry, bool) and abs(entry) < float("inf")
            if not name and not number:
                refuse("must be a number, or the name of a parameter", at=[i, j])
    return tuple(tuple(row) for row in rows)


MatrixOrFile = Annotated[
    Any, BeforeValidator(_matrix), WithJsonSchema({"anyOf": [_ROWS, {"type": "string", "minLength": 1}]})
]


def _quantity(value: Any) -> Any:
    """Take ``level`` for ``{name: level}``."""
    return {"name": value} if isinstance(value, str) else value


class NamedQuantity(Base):
    """A state, input, noise or output of a linear model."""

    name: Text = Field(description="its name: letters, digits and underscores")
    unit: str = Field(default="", description="its unit, such as m/s")
    description: str = Field(default="", description="what it is, in a few words")


Quantities = Annotated[
    tuple[Annotated[NamedQuantity, BeforeValidator(_quantity, json_schema_input_type=str | NamedQuantity)], ...],
    Strict(False),
]


class LinearModel(Base):
    """A linear model by its matrices: next x or dx/dt = A x + B u + G v, y = C x + D u + e."""

    A: MatrixOrFile | None = Field(default=None, description="states by states: rows of numbers, or a CSV file")
    B: MatrixOrFile | None = Field(default=None, description="states by inputs; default: no input")
    G: MatrixOrFile | None = Field(default=None, description="states by noises; default: one noise on each state")
    C: MatrixOrFile | None = Field(default=None, description="outputs by states")
    D: MatrixOrFile | None = Field(default=None, description="outputs by inputs; default: 0")
    file: Text | None = Field(
        default=None,
        description="npz, MAT or HDF5 file with the other matrices under their letters; an array with a further axis "
        "varies over time, one matrix a sample: (samples, rows, columns), in MAT files (rows, columns, samples)",
    )
    states: Quantities = Field(default=(), description="names, or {name, unit, description}; default: x1, x2, ...")
    inputs: Quantities = Field(default=(), description="the same for inputs; default: u1, u2, ...")
    noises: Quantities = Field(default=(), description="the same for process noises; default: v1, v2, ...")
    outputs: Quantities = Field(default=(), description="the same for outputs; default: y1, y2, ...")
    discretisation: Literal["discrete", "exact", "euler", "rk4"] = Field(
        default="discrete",
        description="discrete: A x is the next state; exact, euler, rk4: it is the rate, and this makes steps of it",
    )
    sample_time: Positive = Field(default=1.0, description="interval between samples in a simulation, s")

    @model_validator(mode="after")
    def _check(self) -> Self:
        for letter in ("A", "C"):
            if getattr(self, letter) is None and self.file is None:
                refuse(f"{letter} is missing: give its rows, or a file that holds it")
        return self


class MarkovNoise(Base):
    """First-order Markov processes (coloured noise) in the place of white process noises."""

    on: Names = Field(description="process noises of the model that become Markov processes")
    time_constant: Positive | dict[Text, Positive] = Field(
        description="time constant, s: one for all, or {noise: s}; each is a parameter tau_<noise> of the model"
    )
    keep_white: bool = Field(default=False, description="keep the white noise beside the process")

    @model_validator(mode="after")
    def _check(self) -> Self:
        for i, name in enumerate(self.on):
            if name in self.on[:i]:
                refuse(f"{name} is in the list twice", at=["on", i])
        if isinstance(self.time_constant, dict):
            for name in self.time_constant:
                if name not in self.on:
                    refuse(f"{name} is not in the list `on`", at=["time_constant", name])
            for name in self.on:
                if name not in self.time_constant:
                    refuse(f"{name} is missing: what is its time constant?", at=["time_constant"])
        return self

    @property
    def time_constants(self) -> dict[str, float]:
        """Time constant, s, of each noise."""
        tau = self.time_constant
        return {name: tau[name] if isinstance(tau, dict) else tau for name in self.on}


class ModelChoice(Base):
    """The model: one that comes with noiseid, by name; a class in a file of the user's; or matrices."""

    model_config = ConfigDict(
        json_schema_extra={
            "oneOf": [{"required": ["name"]}, {"required": ["file", "class"]}, {"required": ["linear"]}]
        },
    )

    name: Text | None = Field(default=None, description="a model that comes with noiseid; `noiseid models` lists them")
    file: Text | None = Field(
        default=None,
        description="a Python file with a model, run when loaded; relative to the experiment file",
    )
    class_name: Text | None = Field(default=None, alias="class", description="the class in that file")
    linear: LinearModel | None = Field(default=None, description="a linear model by its matrices")
    parameters: dict[Text, float] = Field(
        default={}, description="parameter values that replace the model's, in its units; of linear: all that it names"
    )
    discretisation: Literal["euler", "rk4", "exact", "van_loan", "discrete"] | None = Field(
        default=None,
        description="how the equations become steps; exact, by the matrix exponential, is for linear ones only; "
        "default: the model's own",
    )
    markov_noise: MarkovNoise | None = Field(
        default=None,
        description="coloured noise: a state xi_<noise> with xi' = -xi/tau + w takes the place of each named noise, "
        "and w_<noise> is the process noise",
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        from_file = self.file is not None or self.class_name is not None
        if (self.name is not None) + from_file + (self.linear is not None) != 1:
            refuse("give one of: name; file and class; linear")
        if from_file and self.class_name is None:
            refuse("class is missing: which class of the file is the model?")
        if from_file and self.file is None:
            refuse("file is missing: which file holds the class?")
        return self

"""The whole of an experiment file."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self, get_args

from pydantic import ConfigDict, Field, Strict, field_validator, model_validator

from noiseid_cli.config.base import Base, Label, Names, Positive, Text, WholeFrom0, refuse
from noiseid_cli.config.schema_estimate import Estimate
from noiseid_cli.config.schema_import import Import
from noiseid_cli.config.schema_simulate import Simulate
from noiseid_cli.config.schema_sweep import Sweep

Format = Literal["html", "md", "csv", "tex", "svg", "png"]
FORMATS: tuple[Format, ...] = get_args(Format)


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
    """The model: one that comes with noiseid, by name, or a class in a file of the user's."""

    model_config = ConfigDict(
        json_schema_extra={"oneOf": [{"required": ["name"]}, {"required": ["file", "class"]}]},
    )

    name: Text | None = Field(default=None, description="a model that comes with noiseid; `noiseid models` lists them")
    file: Text | None = Field(
        default=None,
        description="a Python file with a model, run when loaded; relative to the experiment file",
    )
    class_name: Text | None = Field(default=None, alias="class", description="the class in that file")
    parameters: dict[Text, float] = Field(
        default={}, description="parameter values that replace the model's, in its units"
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
        if (self.name is not None) == from_file:
            refuse("give either name, or file and class")
        if from_file and self.class_name is None:
            refuse("class is missing: which class of the file is the model?")
        if from_file and self.file is None:
            refuse("file is missing: which file holds the class?")
        return self


class Report(Base):
    """What the report holds."""

    title: Text | None = Field(default=None, description="title; default: the name of the experiment")
    formats: Annotated[tuple[Format, ...], Strict(False), Field(min_length=1)] = Field(
        default=FORMATS, description="kinds of file to write; default: all"
    )

    published: Text | None = Field(
        default=None,
        description="a file of published figures to stand beside ours; a relative path starts at the experiment file",
    )

    @field_validator("formats")
    @classmethod
    def _once(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for i, name in enumerate(value):
            if name in value[:i]:
                refuse(f"{name} is in the list twice")
        return value


class Experiment(Base):
    """An experiment: a model, data that is simulated or imported, what to estimate, what to report."""

    model_config = ConfigDict(
        title="noiseid experiment",
        json_schema_extra={"oneOf": [{"required": ["simulate"]}, {"required": ["import"]}]},
    )

    experiment: Label = Field(
        description="name of the experiment and of its folder: letters, digits, dot, underscore, hyphen; at most 64"
    )
    seed: WholeFrom0 = Field(default=0, description="seed of all random numbers, a whole number from 0")
    model: ModelChoice = Field(description="the model")
    simulate: Simulate | None = Field(default=None, description="make datasets by simulation")
    import_: Import | None = Field(default=None, alias="import", description="make datasets from recordings")
    estimate: Estimate | None = Field(default=None, description="what to estimate; left out: data only")
    report: Report = Field(default=Report(), description="what to report")
    sweep: Sweep | None = Field(default=None, description="settings to vary; each point is an experiment of its own")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if message := data_problem({"simulate": self.simulate, "import": self.import_}):
            refuse(message)
        return self


def data_problem(data: dict[str, Any]) -> str | None:
    """Say what is wrong with the choice between simulation and import; None where it is made."""
    given = [name for name in ("simulate", "import") if data.get(name) is not None]
    if len(given) == 2:
        return "give either simulate or import, not both"
    return None if given else "simulate or import is missing: the data must come from somewhere"

"""The whole of an experiment file."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self, get_args

from pydantic import ConfigDict, Field, Strict, field_validator, model_validator

from noiseid_cli.config.base import Base, Label, Text, WholeFrom0, refuse
from noiseid_cli.config.schema_estimate import Estimate
from noiseid_cli.config.schema_import import Import
from noiseid_cli.config.schema_model import ModelChoice
from noiseid_cli.config.schema_simulate import Simulate
from noiseid_cli.config.schema_sweep import Sweep

Format = Literal["html", "md", "csv", "tex", "svg", "png"]
FORMATS: tuple[Format, ...] = get_args(Format)


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
        if self.simulate and self.simulate.held_out and self.estimate and self.estimate.holdout:
            refuse(
                "simulate.held_out makes tests to score on already: give one or the other", at=["estimate", "holdout"]
            )
        return self


def data_problem(data: dict[str, Any]) -> str | None:
    """Say what is wrong with the choice between simulation and import; None where it is made."""
    given = [name for name in ("simulate", "import") if data.get(name) is not None]
    if len(given) == 2:
        return "give either simulate or import, not both"
    return None if given else "simulate or import is missing: the data must come from somewhere"

"""The ``sweep`` section: which settings are varied, over which values."""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, ConfigDict, Field, Strict, WithJsonSchema, model_validator

from noiseid_cli.config.base import Base, Count, Label, Positive, Text, refuse, refuse_order, unique
from noiseid_cli.config.overrides import PathError, parse_path

MAX_POINTS = 100_000
_NOT_VARIED = ("experiment", "sweep", "report")


class DrawUniform(Base):
    """Equally likely between two bounds."""

    kind: Literal["uniform"] = Field(description="equally likely between lowest and highest")
    lowest: float = Field(description="lower bound, in the unit of the setting")
    highest: float = Field(description="upper bound, in the unit of the setting")

    @model_validator(mode="after")
    def _check(self) -> Self:
        refuse_order(self.lowest, self.highest)
        return self


class DrawLogUniform(Base):
    """The logarithm is equally likely between two bounds."""

    kind: Literal["log_uniform"] = Field(description="the logarithm is equally likely between lowest and highest")
    lowest: Positive = Field(description="lower bound, in the unit of the setting")
    highest: Positive = Field(description="upper bound, in the unit of the setting")

    @model_validator(mode="after")
    def _check(self) -> Self:
        refuse_order(self.lowest, self.highest)
        return self


class DrawNormal(Base):
    """Normal."""

    kind: Literal["normal"] = Field(description="normal")
    mean: float = Field(description="mean, in the unit of the setting")
    std: Positive = Field(description="standard deviation, in the unit of the setting")


class DrawLogNormal(Base):
    """The logarithm is normal."""

    kind: Literal["log_normal"] = Field(description="the logarithm is normal")
    median: Positive = Field(description="median, in the unit of the setting")
    spread: Annotated[float, Field(gt=1)] = Field(description="factor at one standard deviation")


Distribution = Annotated[DrawUniform | DrawLogUniform | DrawNormal | DrawLogNormal, Field(discriminator="kind")]


def _paths(value: Any) -> Any:
    """Take one path for a list of one."""
    return [value] if isinstance(value, str) else value


_PATH = {"type": "string", "minLength": 1, "maxLength": 500}
Paths = Annotated[
    tuple[Text, ...],
    Strict(False),
    BeforeValidator(_paths),
    Field(min_length=1),
    WithJsonSchema({"anyOf": [_PATH, {"type": "array", "items": _PATH, "minItems": 1}]}),
]


class Axis(Base):
    """One thing that is varied."""

    model_config = ConfigDict(json_schema_extra={"oneOf": [{"required": ["values"]}, {"required": ["draw"]}]})

    vary: Paths = Field(
        description="the setting, as for --set, such as simulate.samples; a list sets all of them to the same value"
    )
    values: Annotated[tuple[Any, ...], Strict(False), Field(min_length=1)] | None = Field(
        default=None, description="the values, one a point"
    )
    draw: Distribution | None = Field(default=None, description="draw the values, from the experiment's seed")
    count: Count | None = Field(default=None, description="number of values to draw")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.values is None) == (self.draw is None):
            refuse("give either values or draw")
        if (self.draw is None) != (self.count is None):
            refuse("draw and count go together: how many values are drawn?")
        for i, path in enumerate(self.vary):
            _check_path(path, i)
        seen: dict[str, int] = {}
        for i, value in enumerate(self.values or ()):
            text = json.dumps(value, sort_keys=True, default=repr)
            if text in seen:
                refuse(f"is in the list already, as entry {seen[text]}", at=["values", i])
            seen[text] = i
        return self

    @property
    def length(self) -> int:
        """Number of values."""
        return len(self.values) if self.values is not None else int(self.count or 0)


def _check_path(path: str, i: int) -> None:
    try:
        root = parse_path(path)[0]
    except PathError as error:
        refuse(str(error), at=["vary", i])
    if root in _NOT_VARIED:
        refuse(f"{root} cannot be varied: a sweep has one {root}", at=["vary", i])


class Sweep(Base):
    """Run the experiment at many points: each is the experiment with some settings replaced."""

    axes: Annotated[dict[Label, Axis], Field(min_length=1)] = Field(
        description="what is varied, each under a name of its own, which heads a column of the tables"
    )
    combine: Literal["product", "zip"] = Field(
        default="product",
        description="product: every value of one axis with every value of the others; zip: first with first, and so on",
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if twin := unique(list(self.axes)):
            refuse("differs from another name in upper and lower case only", at=["axes", twin])
        lengths = {name: axis.length for name, axis in self.axes.items()}
        first = next(iter(lengths))
        paths: dict[tuple[str, ...], str] = {}
        for name, axis in self.axes.items():
            if self.combine == "zip" and axis.length != lengths[first]:
                refuse(
                    f"has {axis.length} values, but {first} has {lengths[first]}: zip needs as many of each",
                    at=["axes", name],
                )
            for i, text in enumerate(axis.vary):
                path = parse_path(text)
                for other, owner in paths.items():
                    n = min(len(path), len(other))
                    if path[:n] == other[:n]:
                        refuse(f"is varied by {owner} already, in whole or in part", at=["axes", name, "vary", i])
                paths[path] = name
        if self.points > MAX_POINTS:
            refuse(f"makes {self.points} points; at most {MAX_POINTS} are allowed: take fewer values", at=["axes"])
        return self

    @property
    def points(self) -> int:
        """Number of points."""
        lengths = [axis.length for axis in self.axes.values()]
        if self.combine == "zip":
            return lengths[0]
        total = 1
        for length in lengths:
            total *= length
        return total

"""What a method is given, or is to find: covariances, the mean of the first state, parameters of the model."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field, Strict, ValidatorFunctionWrapHandler, WrapValidator, model_validator

from noiseid_cli.config.base import Base, Names, Numbers, Text, refuse
from noiseid_cli.config.covariance import Covariance, NoiseCovariance
from noiseid_cli.config.suggest import did_you_mean

_STRUCTURES = ("full", "diagonal", "scale")


class Blocks(Base):
    """Independent groups: a full covariance within each, zero between them."""

    blocks: Annotated[tuple[Names, ...], Strict(False), Field(min_length=1)] = Field(
        description="the groups, each a list of names; a name in none of them is a group of its own"
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        seen: set[str] = set()
        for i, block in enumerate(self.blocks):
            for j, name in enumerate(block):
                if name in seen:
                    refuse(f"{name} is in a block already", at=["blocks", i, j])
                seen.add(name)
        return self


def _structure(value: Any, handler: ValidatorFunctionWrapHandler) -> Any:
    """Choose between a word and blocks by the look of the value, so that a complaint is about that one only."""
    if isinstance(value, dict):
        return Blocks.model_validate(value)
    if isinstance(value, str) and value not in _STRUCTURES:
        refuse(f"must be one of {', '.join(_STRUCTURES)} or {{blocks: [...]}}{did_you_mean(value, _STRUCTURES)}")
    if not isinstance(value, str | Blocks):
        refuse(f"must be one of {', '.join(_STRUCTURES)} or {{blocks: [...]}}")
    return handler(value)


def _entry(value: Any, handler: ValidatorFunctionWrapHandler) -> Any:
    """Take a name (a variance) or a pair of names (a covariance)."""
    pair = isinstance(value, list | tuple) and len(value) == 2 and all(isinstance(v, str) for v in value)
    if not (pair or (isinstance(value, str) and value)):
        refuse("must be a name, for a variance, or [name, name], for a covariance")
    return tuple(value) if pair else value


Structure = Annotated[Literal["full", "diagonal", "scale"] | Blocks, WrapValidator(_structure)]
FixedEntry = Annotated[str | Annotated[tuple[str, str], Field(min_length=2, max_length=2)], WrapValidator(_entry)]

Tie = Annotated[tuple[Text, ...], Strict(False), Field(min_length=2)]


class CovarianceChoice(Base):
    """A covariance that is known, or one that is estimated from a start."""

    model_config = ConfigDict(json_schema_extra={"oneOf": [{"required": ["known"]}, {"required": ["start"]}]})

    known: Covariance | None = Field(default=None, description="the covariance, taken as it is")
    start: Covariance | None = Field(default=None, description="where the estimation starts from")
    structure: Structure = Field(
        default="full",
        description="full, diagonal, scale (a factor times start) or {blocks: [[names], [names]]}",
    )
    fixed: Annotated[tuple[FixedEntry, ...], Strict(False)] = Field(
        default=(), description="entries held at start: a name for a variance, [name, name] for a covariance"
    )

    tied: Annotated[tuple[Tie, ...], Strict(False)] = Field(
        default=(), description="groups of names whose variances are one unknown, such as [[a, b], [c, d]]"
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.known is None) == (self.start is None):
            refuse("give either known (taken as it is) or start (to be estimated)")
        if self.known is not None:
            for name, idle in (("structure", "full"), ("fixed", ()), ("tied", ())):
                if getattr(self, name) != idle:
                    refuse("goes with start: a known covariance is taken as it is", at=[name])
        if self.structure == "scale" and self.fixed:
            refuse("with structure scale only the factor is estimated: nothing can be fixed", at=["fixed"])
        if self.structure == "scale" and self.tied:
            refuse("with structure scale only the factor is estimated: nothing can be tied", at=["tied"])
        self._check_ties()
        return self

    def _check_ties(self) -> None:
        seen: set[str] = set()
        for i, group in enumerate(self.tied):
            for j, name in enumerate(group):
                if name in self.fixed:
                    refuse(f"{name} is fixed: it cannot be tied as well", at=["tied", i, j])
                if name in seen:
                    refuse(f"{name} is tied already", at=["tied", i, j])
                seen.add(name)


class ProcessNoiseChoice(CovarianceChoice):
    """The covariance of the process noise, known or estimated from a start, per sample or as a density."""

    known: NoiseCovariance | None = Field(default=None, description="the covariance, taken as it is")
    start: NoiseCovariance | None = Field(default=None, description="where the estimation starts from")

    @property
    def density(self) -> bool:
        """It is given, and so estimated, as a density."""
        given = self.known or self.start
        return given is not None and given.unit == "density"


def _mean(value: Any, handler: ValidatorFunctionWrapHandler) -> Any:
    """Take ``truth``, a list for all tests, or one list a test."""
    if isinstance(value, str):
        if value != "truth":
            refuse("must be truth, a list of numbers, or a mapping from each test to one")
        return value
    if isinstance(value, list | tuple):
        return _OneMean.model_validate({"mean": list(value)}).mean
    if isinstance(value, dict):
        return _MeanOfEach.model_validate({"mean": value}).mean
    return refuse("must be truth, a list of numbers, or a mapping from each test to one")


class _OneMean(Base):
    mean: Numbers


class _MeanOfEach(Base):
    mean: dict[Text, Numbers] = Field(min_length=1)


Mean = Annotated[Literal["truth"] | Numbers | dict[Text, Numbers], WrapValidator(_mean)]


class MeanChoice(Base):
    """The mean of the first state: known, or estimated from a start."""

    model_config = ConfigDict(json_schema_extra={"oneOf": [{"required": ["known"]}, {"required": ["start"]}]})

    known: Mean | None = Field(
        default=None,
        description="truth (simulated tests), a list in the units of the states, or {test: list}",
    )
    start: Mean | None = Field(default=None, description="where the estimation starts from; forms as for known")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.known is None) == (self.start is None):
            refuse("give either known (taken as it is) or start (to be estimated)")
        return self


class ParameterChoice(Base):
    """A parameter of the model that is estimated."""

    start: float = Field(description="where the estimation starts from, in the parameter's unit")
    lower: float | None = Field(default=None, description="lower bound; 0 for what cannot be negative; default: none")
    upper: float | None = Field(default=None, description="upper bound; default: none")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.lower is not None and self.start <= self.lower:
            refuse(f"must be above lower, {self.lower:g}, not {self.start:g}", at=["start"])
        if self.upper is not None and self.start >= self.upper:
            refuse(f"must be below upper, {self.upper:g}, not {self.start:g}", at=["start"])
        return self

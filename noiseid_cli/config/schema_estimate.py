"""The ``estimate`` section: what is known, what is to be found from which start, by which methods."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import (
    BeforeValidator,
    ConfigDict,
    Field,
    SerializeAsAny,
    Strict,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    model_validator,
)

from noiseid_cli.config.base import Base, Count, Label, Names, Numbers, Positive, Positives, Text, refuse, unique
from noiseid_cli.config.covariance import Covariance, NoiseCovariance
from noiseid_cli.config.method_base import MethodOptions
from noiseid_cli.config.methods import EmOptions, name_methods, pick_method
from noiseid_cli.config.schema_ensemble import CommonBias, InitialMap, TestRange
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


class LogUniform(Base):
    """Factors whose logarithm is uniform."""

    kind: Literal["log_uniform"] = Field(description="the logarithm of each factor is uniform")
    lowest: Positive = Field(description="smallest factor on a variance")
    highest: Positive = Field(description="largest factor on a variance")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.highest <= self.lowest:
            refuse(f"must be above lowest, {self.lowest:g}, not {self.highest:g}", at=["highest"])
        return self


class LogNormal(Base):
    """Factors whose logarithm is normal with mean zero."""

    kind: Literal["log_normal"] = Field(description="the logarithm of each factor is normal with mean zero")
    spread: Annotated[float, Field(gt=1)] = Field(description="factor on a variance at one standard deviation")


class Draw(Base):
    """Starts that are drawn, from the experiment's seed."""

    count: Count = Field(description="number of starts")
    factors: Annotated[LogUniform | LogNormal, Field(discriminator="kind")] = Field(
        description="distribution of the factor on each variance of the process noise's start"
    )


class Starts(Base):
    """The starts of each method: every one is run."""

    scale: Positives = Field(
        default=(1.0,), description="factors on the start covariance of the process noise, one a start"
    )
    measurement_scale: Positives | None = Field(
        default=None,
        description="factors on the start covariance of the measurement noise, one a start; default: 1",
    )
    draw: Draw | None = Field(default=None, description="draw the starts, each variance by a factor of its own")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.measurement_scale is not None and len(self.measurement_scale) != len(self.scale):
            refuse(
                f"has {len(self.measurement_scale)} factors, but scale has {len(self.scale)}: one of each a start",
                at=["measurement_scale"],
            )
        if self.draw is not None and (self.scale != (1.0,) or self.measurement_scale is not None):
            refuse("takes the place of scale and measurement_scale: give one or the other", at=["draw"])
        return self


class UncertaintyChoice(Base):
    """How standard errors and intervals are found."""

    method: Literal["score", "bootstrap", "none"] = Field(
        default="score",
        description="score: the observed information of a method that maximises the likelihood, from differences of "
        "the score; bootstrap: estimates from data simulated at the estimate, in open loop, for any method; none",
    )
    replicates: Annotated[int, Field(ge=10)] | None = Field(
        default=None, description="number of simulated datasets of the bootstrap; default: 100"
    )
    level: Annotated[float, Field(gt=0, lt=1)] = Field(default=0.95, description="confidence level of the intervals")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.replicates is not None and self.method != "bootstrap":
            refuse("goes with method bootstrap", at=["replicates"])
        return self


class Holdout(Base):
    """A part of each test that no method sees; the filter runs on into it, and is scored there."""

    last: Annotated[float, Field(gt=0, lt=1)] = Field(description="share of the samples at the end of each test")


class Tuning(Base):
    """The noise covariances in use today, to be set beside the estimate; no method starts from them."""

    process_noise: Covariance = Field(description="covariance of the process noise in use, in the unit of the estimate")
    measurement_noise: Covariance = Field(description="covariance of the measurement noise in use")


Method = Annotated[SerializeAsAny[MethodOptions], BeforeValidator(pick_method)]


class OutlierGate(Base):
    """Leave out measurements that the filter at the estimate finds too far off; off unless it is given."""

    probability: Annotated[float, Field(gt=0, lt=1)] = Field(
        default=1e-6, description="share of good measurements that a right filter would leave out"
    )
    per: Literal["sample", "output"] = Field(
        default="sample", description="test all outputs of a sample together, or each output alone"
    )


class Estimate(Base):
    """Find the noise."""

    process_noise: ProcessNoiseChoice = Field(
        description="covariance of the process noise; the estimate has the unit of what is given here"
    )
    measurement_noise: CovarianceChoice = Field(description="covariance of the measurement noise")
    initial_mean: MeanChoice = Field(description="mean of the first state of each test")
    initial_covariance: CovarianceChoice = Field(description="covariance of the first state, the same for all tests")
    parameters: dict[Text, ParameterChoice] = Field(
        default={}, description="parameters of the model that are estimated, by name; the others keep their values"
    )
    outlier_gate: OutlierGate | None = Field(
        default=None,
        description="leave out outliers: fit, test the innovations at the estimate, fit anew without what fails, until "
        "the set is at rest; held-out tests are scored whole. Default: off",
    )
    initial_map: InitialMap | None = Field(
        default=None,
        description="for batch-ml and recursive-ml: how the first state follows from what initial_mean and "
        "initial_covariance are about; default: each state that the model leaves free is one of them",
    )
    common_bias: CommonBias | None = Field(
        default=None, description="for batch-ml and recursive-ml: a bias of outputs that the tests share"
    )
    tests: TestRange = Field(default=TestRange(), description="which tests of each dataset are used")
    continue_from: Text | None = Field(
        default=None,
        description="a result of recursive-ml that takes in the tests used here; --continue on the command line; a "
        "relative path starts at the experiment file",
    )
    tuning: Tuning | None = Field(
        default=None, description="the covariances in use today: the report shows what they give beside the estimate"
    )
    holdout: Holdout | None = Field(
        default=None, description="a part of each test to score on, which no method sees; default: none"
    )
    uncertainty: UncertaintyChoice = Field(
        default=UncertaintyChoice(), description="how standard errors and intervals are found"
    )
    starts: Starts = Field(default=Starts(), description="starts to be tried")
    methods: Annotated[dict[Label, Method], Field(min_length=1), BeforeValidator(name_methods)] = Field(
        default={"em": EmOptions()},
        description="methods to be run, each under a label of its own, with its options",
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if twin := unique(list(self.methods)):
            refuse("differs from another label in upper and lower case only", at=["methods", twin])
        return self

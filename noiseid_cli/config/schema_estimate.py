"""The ``estimate`` section: what is known, what is to be found from which start, by which methods."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, SerializeAsAny, model_validator

from noiseid_cli.config.base import Base, Label, Text, refuse, unique
from noiseid_cli.config.covariance import Covariance
from noiseid_cli.config.method_base import MethodOptions
from noiseid_cli.config.methods import EmOptions, name_methods, pick_method
from noiseid_cli.config.schema_ensemble import CommonBias, InitialMap, TestRange
from noiseid_cli.config.schema_starts import Starts
from noiseid_cli.config.schema_unknowns import CovarianceChoice, MeanChoice, ParameterChoice, ProcessNoiseChoice


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

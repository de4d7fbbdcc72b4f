"""The options of each estimation method: one class a method, in one dict."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from noiseid_cli.config.base import Base, Count, NotNegative, Positive, Text, WholeFrom0, refuse
from noiseid_cli.config.method_base import KINDS, MethodOptions
from noiseid_cli.config.methods_ensemble import BatchMlOptions, RecursiveMlOptions
from noiseid_cli.config.methods_online import AsrukfOptions, JointSrukfOptions, SbAsrukfOptions
from noiseid_cli.config.suggest import did_you_mean


class EmOptions(MethodOptions):
    """Expectation maximisation with an extended, unscented or cubature Kalman smoother."""

    summary: ClassVar[str] = (
        "expectation maximisation with an extended (or unscented, cubature) Kalman smoother, with quasi-Newton steps"
    )
    estimates: ClassVar[str] = "Q, R, m0, P0 (full, diagonal, blocks, scale, entries held or tied)"
    citation: ClassVar[str] = (
        "P. Axelsson, U. Orguner, F. Gustafsson, M. Norrlof: ML estimation of process noise variance in dynamic "
        "systems, poster, 2011 (EM with an extended Kalman smoother)"
    )
    can: ClassVar[frozenset[str]] = frozenset({"Q", "R", "m0", "P0"})

    has_score: ClassVar[bool] = True

    method: Literal["em"] = Field(
        default="em", description="expectation maximisation; default: the label it stands under"
    )
    smoother: Literal["extended", "unscented", "cubature"] = Field(
        default="extended",
        description="what smooths the states: by linearisation, or by sigma points, as are then the moments and the "
        "reported likelihood",
    )
    alpha: Positive = Field(default=1.0, description="spread of the unscented points; with smoother unscented")
    beta: NotNegative = Field(
        default=2.0, description="weight of the central unscented point, 2 for normal noise; with smoother unscented"
    )
    kappa: float | None = Field(
        default=None,
        description="second spread of the unscented points; default: 3 minus the number of states; with smoother "
        "unscented",
    )
    linearisation: Literal["smoothed", "filtered"] = Field(
        default="smoothed",
        description="states at which the M-step linearises: anew at the smoothed ones, or the filter's own; with "
        "smoother extended",
    )
    acceleration: Literal["quasi_newton", "none"] = Field(
        default="quasi_newton",
        description="quasi-Newton steps between those of EM, where they raise the likelihood; none is the algorithm as "
        "published",
    )
    max_passes: Count = Field(default=500, description="largest number of passes over the data")
    loglik_tolerance: NotNegative = Field(
        default=1e-3,
        description="change of the log-likelihood in a pass below which it counts as still, nats",
    )
    parameter_tolerance: NotNegative = Field(
        default=1e-5,
        description="relative change of the covariances in a pass below which they count as still",
    )
    stop: Literal["both", "loglik", "parameters"] = Field(
        default="both",
        description="what must be still to stop; loglik with tolerance 0 is the published rule",
    )
    fall_tolerance: NotNegative = Field(
        default=1e-3, description="fall of the log-likelihood that the acceleration still accepts, nats"
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        for name in ("alpha", "beta", "kappa"):
            if self.smoother != "unscented" and getattr(self, name) != EmOptions.model_fields[name].default:
                refuse(f"goes with smoother unscented, not {self.smoother}", at=[name])
        if self.smoother != "extended" and self.linearisation != "smoothed":
            refuse(f"goes with smoother extended: the {self.smoother} one does not linearise", at=["linearisation"])
        return self


class Alg2Options(MethodOptions):
    """Minimisation of the filter's path error; needs a known true path."""

    summary: ClassVar[str] = "minimisation of the path error of the extended Kalman filter; needs the true path"
    estimates: ClassVar[str] = "Q (diagonal)"
    citation: ClassVar[str] = EmOptions.citation.replace("EM with an extended Kalman smoother", "Alg. 2")
    can: ClassVar[frozenset[str]] = frozenset({"Q"})
    structures: ClassVar[frozenset[str]] = frozenset({"diagonal"})

    method: Literal["alg2"] = Field(
        default="alg2", description="minimisation of the path error; default: the label it stands under"
    )
    optimiser: Literal["least_squares", "nelder_mead"] = Field(
        default="least_squares", description="Gauss-Newton steps on the path errors, or a search by values only"
    )
    max_passes: Count = Field(default=1000, description="largest number of filter runs over the data")
    parameter_tolerance: NotNegative = Field(
        default=1e-5, description="step of the log variances below which they count as still"
    )
    objective_tolerance: NotNegative = Field(
        default=1e-9, description="relative change of the path error below which it counts as still"
    )
    lambda_span: Annotated[float, Field(gt=1)] = Field(
        default=1e8, description="each variance is searched between 1 / lambda_span and lambda_span of its start"
    )


class Alg3Options(MethodOptions):
    """Iterative covariance of the noise that the smoothed states imply."""

    summary: ClassVar[str] = "iterative sample covariance of the noise that the smoothed states imply; biased low"
    estimates: ClassVar[str] = "Q (full, diagonal, blocks, scale, entries held or tied)"
    citation: ClassVar[str] = EmOptions.citation.replace("EM with an extended Kalman smoother", "Alg. 3")
    can: ClassVar[frozenset[str]] = frozenset({"Q"})

    method: Literal["alg3"] = Field(
        default="alg3", description="iterative covariance estimation; default: the label it stands under"
    )
    max_passes: Count = Field(default=500, description="largest number of passes over the data")
    parameter_tolerance: NotNegative = Field(
        default=1e-5, description="relative change of the covariances in a pass below which they count as still"
    )
    zero_tolerance: NotNegative = Field(
        default=1e-6, description="share of its start below which a standard deviation counts as gone to zero"
    )


class ProfileChoice(Base):
    """Which profile likelihood is wanted."""

    unknown: Text = Field(description="a model parameter; or a noise, output or state, for its standard deviation")
    points: Annotated[int, Field(ge=3, le=201)] = Field(default=15, description="number of values, rounded up to odd")
    span: Positive = Field(default=3.0, description="distance of the outermost from the maximum, in standard errors")


class MlOptions(MethodOptions):
    """Direct maximum likelihood of any mix of unknowns, model parameters among them."""

    summary: ClassVar[str] = (
        "direct maximum likelihood: quasi-Newton on the exact gradient of the extended Kalman filter's log-likelihood"
    )
    estimates: ClassVar[str] = "Q, R, m0, P0 (full, diagonal, blocks, scale, entries held or tied), model parameters"
    citation: ClassVar[str] = (
        "K. J. Astrom: Maximum likelihood and prediction error methods, Automatica 16 (1980) 551-574 (prediction "
        "errors of a Kalman filter); J. Nocedal, S. J. Wright: Numerical Optimization, 2006 (BFGS)"
    )
    can: ClassVar[frozenset[str]] = frozenset(KINDS)

    has_score: ClassVar[bool] = True

    method: Literal["ml"] = Field(
        default="ml", description="direct maximum likelihood; default: the label it stands under"
    )
    gradient: Literal["exact", "differences"] = Field(
        default="exact", description="reverse derivatives of the filter, or central differences"
    )
    em_passes: WholeFrom0 = Field(
        default=3,
        description="passes of EM over the unknown noise before the climb; model parameters wait meanwhile. With 0 EM "
        "does not look either whether the climb ended on a tooth of a jagged log-likelihood",
    )
    max_passes: Count = Field(default=1000, description="largest number of runs over the data")
    loglik_tolerance: Positive = Field(
        default=1e-3, description="rise that the Newton step may still promise at the end, nats"
    )
    profile: ProfileChoice | None = Field(
        default=None, description="{unknown: NAME, points, span}: profile likelihood of one unknown; default: none"
    )


METHOD_OPTIONS: dict[str, type[MethodOptions]] = {
    "em": EmOptions,
    "ml": MlOptions,
    "alg2": Alg2Options,
    "alg3": Alg3Options,
    "asrukf": AsrukfOptions,
    "sb-asrukf": SbAsrukfOptions,
    "joint-srukf": JointSrukfOptions,
    "batch-ml": BatchMlOptions,
    "recursive-ml": RecursiveMlOptions,
}
"""Every known method, by the name used in experiment files."""


def name_methods(value: Any) -> Any:
    """Fill in each ``method`` that is left out from its label, before validation."""
    if not isinstance(value, dict):
        return value
    named = {label: {} if options is None else options for label, options in value.items()}
    return {
        label: {"method": label, **options} if isinstance(options, dict) else options
        for label, options in named.items()
    }


def pick_method(value: Any) -> Any:
    """Validate the options of one method by the class that the method has in ``METHOD_OPTIONS``."""
    if isinstance(value, MethodOptions) or not isinstance(value, dict):
        return value
    name = value.get("method")
    if not isinstance(name, str) or name not in METHOD_OPTIONS:
        known = list(METHOD_OPTIONS)
        refuse(f"{name!r} is not a method; known: {', '.join(known)}{did_you_mean(name, known)}", at=["method"])
    return METHOD_OPTIONS[name].model_validate(value)

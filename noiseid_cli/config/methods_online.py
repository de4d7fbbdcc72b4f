"""The options of the filters that estimate sample by sample."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from noiseid_cli.config.base import NotNegative, Positive, Text, WholeFrom0
from noiseid_cli.config.method_base import MethodOptions


class OnlineOptions(MethodOptions):
    """What the filters that estimate parameters sample by sample share."""

    citation: ClassVar[str] = (
        "M. H. Riva, M. Wielitzka, T. Ortmaier: Sensitivity-based adaptive SRUKF for state, parameter, and covariance "
        "estimation on mechatronic systems, in: Kalman Filters - Theory for Advanced Applications, InTechOpen, 2017, "
        "doi:10.5772/intechopen.72470"
    )

    alpha: Positive = Field(default=0.85, description="spread of the sigma points")
    beta: float = Field(default=2.0, description="knowledge of the distribution; 2 for a normal one")
    kappa: float | None = Field(
        default=None, description="second spread of the sigma points; default: 3 - n, n the number of states"
    )
    parameter_covariance: Annotated[dict[Text, NotNegative], Field(min_length=1)] = Field(
        description="variance at the start of each unknown, by the name of its parameter or noise, in its unit squared"
    )


class AsrukfOptions(OnlineOptions):
    """Adaptive square-root unscented Kalman filter, running freely."""

    summary: ClassVar[str] = "adaptive square-root unscented filter: states, parameters and variances, sample by sample"
    estimates: ClassVar[str] = "Q (diagonal, entries held), parameters of the model"
    can: ClassVar[frozenset[str]] = frozenset({"Q", "parameters"})
    structures: ClassVar[frozenset[str]] = frozenset({"diagonal", "fixed"})

    method: Literal["asrukf"] = Field(
        default="asrukf", description="adaptive square-root unscented filter; default: the label it stands under"
    )
    forgetting: Annotated[float, Field(gt=0, le=1)] = Field(
        default=0.999, description="factor by which old innovations lose weight at each sample"
    )
    window: WholeFrom0 = Field(
        default=0,
        description="samples over which the maximum of a sensitivity is taken; 0: all since the start",
    )
    variance_floor: NotNegative = Field(
        default=1e-6, description="share of its start below which a variance is not let"
    )


class SbAsrukfOptions(AsrukfOptions):
    """The same with an excitation monitor."""

    summary: ClassVar[str] = "asrukf with an excitation monitor: a parameter is held while the data do not excite it"

    method: Literal["sb-asrukf"] = Field(  # type: ignore[assignment]
        default="sb-asrukf", description="asrukf with an excitation monitor; default: the label it stands under"
    )
    thresholds: dict[Text, NotNegative] = Field(
        default={},
        description="excitation below which a parameter is held, between 0 and the number of states; 0.05 for those "
        "not named. Variances are never held",
    )


class JointSrukfOptions(OnlineOptions):
    """Parameters as further states."""

    summary: ClassVar[str] = "square-root unscented filter of states and parameters in one vector"
    estimates: ClassVar[str] = "parameters of the model"
    can: ClassVar[frozenset[str]] = frozenset({"parameters"})

    method: Literal["joint-srukf"] = Field(
        default="joint-srukf", description="joint square-root unscented filter; default: the label it stands under"
    )
    parameter_noise: Annotated[dict[Text, NotNegative], Field(min_length=1)] = Field(
        description="variance that each sample adds to each parameter, by name, in its unit squared"
    )
    hold_process_noise: bool = Field(
        default=False, description="keep the process noise at its start, where other methods estimate it"
    )

"""From where each method starts: factors on the start of the process noise, given or drawn."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from noiseid_cli.config.base import Base, Count, Positive, Positives, refuse, refuse_order


class LogUniform(Base):
    """Factors whose logarithm is uniform."""

    kind: Literal["log_uniform"] = Field(description="the logarithm of each factor is uniform")
    lowest: Positive = Field(description="smallest factor on a variance")
    highest: Positive = Field(description="largest factor on a variance")

    @model_validator(mode="after")
    def _check(self) -> Self:
        refuse_order(self.lowest, self.highest)
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

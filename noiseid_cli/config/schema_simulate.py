"""The ``simulate`` section: how many tests of what length, which motion, which noise."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, Strict, model_validator

from noiseid_cli.config.base import Base, Count, NotNegatives, Numbers, Positive, WholeFrom2, refuse
from noiseid_cli.config.covariance import Covariance, NoiseCovariance


class Square(Base):
    """The tool runs round a square under closed-loop control; only for the model flexible_robot."""

    kind: Literal["square"] = Field(description="the tool runs round a square")
    corner: Annotated[tuple[float, float], Strict(False)] = Field(
        description="x and y of the first corner in the plane of the arm, m"
    )
    side: Positive = Field(description="length of a side, m")
    side_time: Positive = Field(description="time for one side, s")


class Zero(Base):
    """All inputs are zero."""

    kind: Literal["zero"] = Field(description="all inputs are zero")


class Multisine(Base):
    """Each input is a sum of sines of equal power, with phases that keep its peak low."""

    kind: Literal["multisine"] = Field(description="each input is a sum of sines of equal power")
    amplitude: NotNegatives = Field(description="peak amplitude of each input, in the unit of the input")
    lowest: Positive = Field(description="lowest frequency, Hz")
    highest: Positive = Field(description="highest frequency, Hz")
    lines: Count = Field(description="number of sines, spread over lowest to highest")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.highest < self.lowest:
            refuse(f"must be at least lowest, {self.lowest:g} Hz, not {self.highest:g}", at=["highest"])
        if self.lines > 1 and self.highest == self.lowest:
            refuse(f"{self.lines} lines need a highest frequency above the lowest", at=["lines"])
        return self


class Steps(Base):
    """Each input jumps between plus and minus its amplitude, all combinations of signs in turn."""

    kind: Literal["steps"] = Field(description="each input jumps between plus and minus its amplitude")
    amplitude: NotNegatives = Field(description="largest level of each input, in the unit of the input")
    hold: Positive = Field(description="time for which a level is held, s")


Trajectory = Annotated[Square | Zero | Multisine | Steps, Field(discriminator="kind")]


class HeldOut(Base):
    """Tests that no method sees: the estimates are scored on them."""

    tests: Count = Field(description="number of tests, each with noise of its own")
    trajectory: Trajectory = Field(description="the motion, best another one than that of the data")


class Simulate(Base):
    """Make datasets with a known truth."""

    samples: WholeFrom2 = Field(description="number of samples of each test, at least 2")
    sample_time: Positive | None = Field(
        default=None, description="interval between samples, s; default: the model's own"
    )
    tests: Count = Field(default=1, description="number of tests in a dataset; they share the unknowns")
    replicates: Count = Field(default=1, description="number of datasets, each with noise of its own")
    trajectory: Trajectory = Field(description="the motion, or the inputs that make it")
    process_noise: NoiseCovariance = Field(description="true covariance of the process noise")
    measurement_noise: Covariance = Field(description="true covariance of the measurement noise")
    held_out: HeldOut | None = Field(default=None, description="further tests on which the estimates are scored")
    initial_state: Numbers | None = Field(
        default=None,
        description="first state of each test, in the units of the states; default: where the motion starts, or 0",
    )

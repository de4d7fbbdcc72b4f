"""The ``simulate`` section: how many tests of what length, which motion, which noise."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, Strict, model_validator

from noiseid_cli.config.base import (
    Base,
    Count,
    Matrix,
    NotNegative,
    NotNegatives,
    Numbers,
    Positive,
    Text,
    WholeFrom2,
    refuse,
)
from noiseid_cli.config.covariance import Covariance, NoiseCovariance
from noiseid_cli.simulation.s_curve import rests


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


class Hold(Base):
    """A longer rest of the reference."""

    begin: Positive = Field(description="time at which it begins, s, while the reference rests after a move")
    end: Positive = Field(description="time at which the reference moves on, s")


class SCurve(Base):
    """One joint moves to and fro between two values under cascade control.

    The controller sets u = speed_gain (position_gain (r - y) + r' - y') with y' a filtered difference of the output.
    """

    kind: Literal["s_curve"] = Field(description="one joint moves to and fro under closed-loop control")
    input: Text = Field(description="the input that drives the joint; all others are zero")
    output: Text = Field(description="the output that follows the reference, such as the measured angle of the joint")
    between: Annotated[tuple[float, float], Strict(False)] = Field(
        description="the two values that the reference moves between, in the output's unit"
    )
    start: float | None = Field(
        default=None,
        description="first value of the reference, which first moves to the second of the two; default: the first",
    )
    move_time: Positive = Field(description="time of a move, s")
    dwell: NotNegative = Field(description="rest after each move, s")
    hold: Hold | None = Field(default=None, description="a longer rest: the reference stays where it is")
    position_gain: Positive = Field(description="gain on the error of position, 1/s")
    speed_gain: Positive = Field(description="gain on the error of speed, in units of the input per unit of speed")
    cutoff: Positive = Field(description="bandwidth of the filter on the differences of the output, Hz")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.hold is None:
            return self
        if self.hold.end <= self.hold.begin:
            refuse(f"must be after begin, {self.hold.begin:g} s, not {self.hold.end:g}", at=["hold", "end"])
        period = self.move_time + self.dwell
        if not rests(self.hold.begin, self.move_time, self.dwell):
            end = (self.hold.begin // period) * period + self.move_time
            refuse(
                f"the reference moves at {self.hold.begin:g} s; it rests from {end:g} to {end + self.dwell:g} s",
                at=["hold", "begin"],
            )
        return self


class StateFeedback(Base):
    """The inputs are fed back from the state that a Kalman filter with the true model finds in the outputs."""

    kind: Literal["state_feedback"] = Field(description="inputs fed back from a Kalman filter's state")
    gain: Matrix = Field(description="u = -gain x: a row for each input, a column for each state")


Trajectory = Annotated[Square | Zero | Multisine | Steps | SCurve | StateFeedback, Field(discriminator="kind")]


class ParameterChange(Base):
    """Parameters of the model that change during each test, and stay so until a later change."""

    at: Positive = Field(description="time from the first sample, s")
    set: dict[Text, float] = Field(default={}, description="new values by name, in the parameters' units")
    scale: dict[Text, float] = Field(default={}, description="factors by name, on the values in force until then")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not self.set and not self.scale:
            refuse("changes nothing: give set or scale, such as {scale: {mass: 2}}")
        for name in self.scale:
            if name in self.set:
                refuse("stands in set too: give one of the two", at=["scale", name])
        return self


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
    parameter_changes: tuple[ParameterChange, ...] = Field(
        default=(), strict=False, description="parameters of the model that change during each test; default: none do"
    )
    initial_state: Numbers | None = Field(
        default=None,
        description="first state of each test, in the units of the states; default: where the motion starts, or 0",
    )
    initial_covariance: Covariance | None = Field(
        default=None,
        description="covariance of the first state, drawn anew in each test; default: each test starts at its mean",
    )
    first_output: bool = Field(
        default=True, description="false: the first sample is not measured, outputs begin one interval later"
    )

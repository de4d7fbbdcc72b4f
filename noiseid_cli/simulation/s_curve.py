"""One actuated joint that moves to and fro under cascade control, as the one-link robot and the pendubot do.

riva2017_sensitivity_asrukf names an s-curve and a "classical cascade structure with P- and P-feedback controllers for
position and speed"; its law of time, gains and filter are not printed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from noiseid_cli.models.recording import Array
from noiseid_cli.simulation.trajectory import LAW

_ROUNDING = 1e-9  # share of a period within which a time counts as the end of a move


@dataclass(frozen=True)
class SCurve:
    """A reference that moves between two values and rests at each.

    Attributes:
        between: the two values.
        start: first value; the first move goes from there to the second of the two.
        move_time: time of a move, s.
        dwell: rest after each move, s.
        hold: begin and end of a longer rest, s, which begins where the reference rests; None for none.
    """

    between: tuple[float, float]
    start: float
    move_time: float
    dwell: float
    hold: tuple[float, float] | None = None

    def at(self, time: Array) -> tuple[Array, Array]:
        """(N,) values and their rates per second at the given times."""
        if self.hold is not None:
            begin, end = self.hold
            time = np.where(time < begin, time, np.maximum(time - (end - begin), begin))
        period = self.move_time + self.dwell
        number = np.floor(time / period + _ROUNDING)
        s = np.clip((time - number * period) / self.move_time, 0.0, 1.0)
        low, high = self.between
        goal = np.where(number % 2 == 0, high, low)
        origin = np.where(number == 0, self.start, np.where(number % 2 == 0, low, high))
        way = goal - origin
        return origin + LAW(s) * way, LAW.deriv(1)(s) * way / self.move_time


def rests(time: float, move_time: float, dwell: float) -> bool:
    """Whether an s-curve rests at a time, ends of a rest included; see ``SCurve``."""
    period = move_time + dwell
    phase = math.fmod(time, period)
    return phase >= move_time - _ROUNDING * period or phase <= _ROUNDING * period


class Cascade:
    """u = Kv (Kp (r - y) + r' - y'), y' a filtered difference of y; see ``simulation.rollout.Controller``."""

    def __init__(
        self,
        reference: tuple[Array, Array],
        dt: float,
        *,
        gains: tuple[float, float],
        cutoff: float,
        acts_on: int,
        reads: int,
        inputs: int,
    ) -> None:
        """Follow a reference.

        Args:
            reference: (N,) values r and rates r'.
            dt: interval between samples, s.
            gains: Kp in 1/s, and Kv in units of the input per unit of the output's rate.
            cutoff: bandwidth of the filter, Hz.
            acts_on: index of the input that it sets; all others are zero.
            reads: index of the output that follows the reference.
            inputs: number of inputs.
        """
        self.reads = (reads,)
        self._r, self._dr = (part.tolist() for part in reference)
        self._dt, self._gains = dt, gains
        self._keep = math.exp(-2 * math.pi * cutoff * dt)
        self._acts_on, self._inputs = acts_on, inputs
        self.start()

    def start(self) -> None:
        """Forget the last test."""
        self._speed = 0.0
        self._last: float | None = None

    def control(self, k: int, y: Array) -> Array:
        """(inputs,) input at sample k."""
        position = float(y[self.reads[0]])
        if self._last is not None:
            self._speed = self._keep * self._speed + (1 - self._keep) * (position - self._last) / self._dt
        self._last = position
        Kp, Kv = self._gains
        u = np.zeros(self._inputs)
        u[self._acts_on] = Kv * (Kp * (self._r[k] - position) + self._dr[k] - self._speed)
        return u

"""A square path of a tool, and the arm angles that follow it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial

from noiseid_cli.errors import ModelError
from noiseid_cli.models.recording import Array

LAW = Polynomial([0, 0, 0, 0, 35, -84, 70, -20])
"""Share of a way travelled at share s of its time: speed, acceleration and jerk are zero at both ends."""

_DIRECTIONS = np.array([[0.0, 1.0], [1.0, 0.0], [0.0, -1.0], [-1.0, 0.0]])  # up, right, down, left


@dataclass(frozen=True)
class SquarePath:
    """A square run clockwise from its lower left corner, over and over, with a rest at each corner.

    Attributes:
        corner: position of the first corner, m.
        side: length of a side, m.
        side_time: time for one side, s.
    """

    corner: tuple[float, float]
    side: float
    side_time: float

    def at(self, time: Array) -> tuple[Array, Array, Array]:
        """(N, 2) position in m, velocity in m/s and acceleration in m/s^2 at the given times."""
        number = np.floor(time / self.side_time)
        s = time / self.side_time - number
        turn = number.astype(int) % 4
        corners = np.array(self.corner) + self.side * np.vstack(([0.0, 0.0], np.cumsum(_DIRECTIONS, axis=0)[:3]))
        way = self.side * _DIRECTIONS[turn]
        law, rate = LAW, 1.0 / self.side_time
        position = corners[turn] + law(s)[:, None] * way
        velocity = rate * law.deriv(1)(s)[:, None] * way
        return position, velocity, rate**2 * law.deriv(2)(s)[:, None] * way


def arm_reference(path: SquarePath, time: Array, l1: float, l2: float) -> tuple[Array, Array, Array]:
    """Arm angles of the flexible robot along a path: px = l1 sin q1 + l2 cos s, py = l1 cos q1 - l2 sin s, s = q1 + q2.

    Args:
        path: the tool's path.
        time: (N,) times, s.
        l1, l2: arm lengths, m.

    Returns:
        (N, 2) angles in rad, with the elbow above the line to the tool, and their first and second derivatives.

    Raises:
        ModelError: the path leaves the arm's reach.
    """
    position, velocity, acceleration = path.at(time)
    x, y = position.T
    cos_elbow = (x**2 + y**2 - l1**2 - l2**2) / (2 * l1 * l2)
    if np.abs(cos_elbow).max() >= 1:
        raise ModelError(
            f"the square leaves the reach of the robot: its tool reaches points between {abs(l1 - l2):.3g} and "
            f"{l1 + l2:.3g} m from its base. Move the corner or shorten the side."
        )
    elbow = -np.arccos(cos_elbow)  # arm 2 against arm 1, counted as in the (x, y) plane
    first = np.arctan2(y, x) - np.arctan2(l2 * np.sin(elbow), l1 + l2 * np.cos(elbow))
    q1, s = np.pi / 2 - first, -(first + elbow)
    sin1, cos1, sin, cos = l1 * np.sin(q1), l1 * np.cos(q1), l2 * np.sin(s), l2 * np.cos(s)
    jacobian = np.moveaxis(np.array([[cos1 - sin, -sin], [-sin1 - cos, -cos]]), -1, 0)
    dq = _solve(jacobian, velocity)
    ds = dq.sum(axis=1)
    bend = np.column_stack([-sin1 * dq[:, 0] ** 2 - cos * ds**2, -cos1 * dq[:, 0] ** 2 + sin * ds**2])
    return np.column_stack([q1, s - q1]), dq, _solve(jacobian, acceleration - bend)


def _solve(matrices: Array, vectors: Array) -> Array:
    return np.asarray(np.linalg.solve(matrices, vectors[..., None])[..., 0], dtype=np.float64)

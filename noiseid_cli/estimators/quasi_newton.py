"""A quasi-Newton climb on a log-likelihood: BFGS with bounded steps and backtracking.

Nocedal & Wright, Numerical Optimization (2006), alg. 6.1, with three changes that a likelihood over log standard
deviations asks for: no step is longer than ``LONGEST`` in any coordinate; a point where the filter fails counts as
too far; and where the curvature is not that of a maximum the steps grow instead of bending the approximation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from noiseid_cli.estimators.likelihood import Point
from noiseid_cli.models.recording import Array

# chosen: a factor of e^2 on a standard deviation in one step, of e^1/2 in the first.
LONGEST, FIRST = 2.0, 0.5
# Share of the promised rise that a step must bring (Armijo), growth where the curvature is wrong, and bisections.
ARMIJO, GROWTH, SHORTENINGS = 1e-4, 4.0, 30
# Where the promise is this share of its tolerance, long steps lead over a plain: a way to zero or to a bound.
FLAT = 1e-3
# A rise below this share of the log-likelihood is rounding of its sum.
ROUNDING = 1e-13


class Differentiable(Protocol):
    """What can be climbed."""

    def point(self, z: Array) -> Point:
        """Value and gradient at z."""


@dataclass(frozen=True)
class Climb:
    """The end of a climb.

    Attributes:
        point: the best point.
        inverse: (d, d) approximate inverse of the information there.
        promise: rise of the log-likelihood that the approximation still promises, g' B g / 2.
        step: largest change of a coordinate that it still proposes.
        stop: ``rest`` (promise and step below their tolerances), ``stuck`` (no rise along the proposed step) or
            ``full`` (out of passes).
    """

    point: Point
    inverse: Array
    promise: float
    step: float
    stop: str


def climb(
    likelihood: Differentiable,
    start: Point,
    inverse: Array | None = None,
    tolerance: float = 1e-6,
    step_tolerance: float = 1e-4,
    full: Callable[[], bool] = lambda: False,
) -> Climb:
    """Climb to a point where the gradient promises no more.

    Args:
        likelihood: gives values and gradients.
        start: a point where the log-likelihood is finite.
        inverse: (d, d) first approximation of the inverse information; scaled unit matrix if not given.
        tolerance: rest is a promise of at most this much log-likelihood,
        step_tolerance: and a proposed step of at most this in every coordinate.
        full: says when to give up.
    """
    now = start
    unscaled = inverse is None
    d = now.z.size
    B = np.eye(d) if inverse is None else inverse
    if unscaled:
        B = B * FIRST / max(float(np.max(np.abs(now.gradient), initial=0.0)), np.finfo(float).tiny)
    fresh = unscaled
    while True:
        step = B @ now.gradient
        promise, size = 0.5 * float(now.gradient @ step), float(np.max(np.abs(step), initial=0.0))
        if not np.all(np.isfinite(step)):
            return Climb(now, B, promise, size, "stuck")
        still = size <= step_tolerance or promise <= FLAT * tolerance
        if not unscaled and promise <= tolerance and still:
            return Climb(now, B, promise, size, "rest")
        if full():
            return Climb(now, B, promise, size, "full")
        after = _search(likelihood, now, step * min(1.0, LONGEST / size) if size > 0.0 else step)
        if after is None:
            if fresh:
                return Climb(now, B, promise, size, "stuck")
            # Start the approximation afresh once before giving up.
            B = np.diag(np.diag(B)) if not unscaled else B
            fresh = True
            continue
        s, y = after.z - now.z, now.gradient - after.gradient
        B, unscaled = _updated(B, s, y, unscaled)
        fresh = False
        now = after


def _search(likelihood: Differentiable, now: Point, step: Array) -> Point | None:
    """A point along the step that rises enough; None where there is none."""
    slope = float(now.gradient @ step)
    if not slope > 0.0:
        return None
    length = 1.0
    noise = ROUNDING * abs(now.loglik)
    for _ in range(SHORTENINGS):
        trial = likelihood.point(now.z + length * step)
        usable = np.isfinite(trial.loglik) and bool(np.all(np.isfinite(trial.gradient)))
        if usable and trial.loglik >= now.loglik + ARMIJO * length * slope - noise:
            # At the end, where the rise drowns in rounding, the gradient has to fall instead.
            if trial.loglik > now.loglik + noise or abs(float(trial.gradient @ step)) < 0.9 * slope:
                return trial
            return None
        if usable:
            # Minimum of the parabola through both values and the first slope.
            curvature = 2.0 * (now.loglik + length * slope - trial.loglik)
            length *= float(np.clip(length * slope / curvature, 0.1, 0.5))
        else:
            length *= 0.25
        if length * float(np.max(np.abs(step))) < 1e-12:
            return None
    return None


def _updated(B: Array, s: Array, y: Array, unscaled: bool) -> tuple[Array, bool]:
    """The BFGS update of the inverse information (Nocedal & Wright, eq. 6.17); whether it still lacks a scale."""
    sy = float(s @ y)
    if not sy > 1e-10 * float(np.linalg.norm(s) * np.linalg.norm(y)):
        return GROWTH * B, unscaled
    if unscaled:
        B = np.eye(s.size) * sy / float(y @ y)
    left = np.eye(s.size) - np.outer(s, y) / sy
    return left @ B @ left.T + np.outer(s, s) / sy, False

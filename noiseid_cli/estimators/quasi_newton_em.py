"""Quasi-Newton acceleration of EM, with the score and the complete-data information of the passes themselves.

After Lange (Statistica Sinica 5, 1995) and Jamshidian & Jennrich (JRSS B 59, 1997, algorithm QN2): an EM step is about
a Newton step with the information that the noise itself would hold, C^-1 g; secants of the score g teach how much of C
the data lack. Here they are those of limited-memory BFGS (Nocedal & Wright, Numerical Optimization, 2006, alg. 7.4),
which starts from C^-1 at the present point, scaled by the last secant (as their eq. 7.20): one pass a step, no search.

The score is that of EM's own statistics, see ``score``, so that its zeros are EM's fixed points.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from noiseid_cli.estimators.em_run import EmPoint, EmRun
from noiseid_cli.estimators.score import score_of
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array

# chosen, here and below: secants that are remembered.
MEMORY = 20
# First and last bound on a step in any coordinate, a factor of e^2 and e^8 on a standard deviation; what a rejection
# leaves of the step, and by how much the bound grows again.
FIRST, LAST, SHRINKAGE, GROWTH = 2.0, 8.0, 0.25, 2.0
# A secant whose angle to the change of the score has a cosine below this says nothing of a maximum.
FLAT = 1e-10


@dataclass(frozen=True)
class _Seen:
    """A visited point: (d,) coordinates, (d,) score, (d, d) complete-data information, and EM's step from there."""

    z: Array
    gradient: Array
    complete: Array
    step: Array


class QuasiNewtonEm:
    """Proposes steps between the EM steps of a run.

    A rejected point shortens the steps and still gives its secant. Where the bound is no longer than the EM step
    itself, the EM step is taken, which needs no check.
    """

    def __init__(self, run: EmRun) -> None:
        """For this run, whose ``statistics`` are those of its last pass."""
        self._run = run
        self._secants: deque[tuple[Array, Array]] = deque(maxlen=MEMORY)
        self._last: _Seen | None = None
        self._longest = FIRST
        self._size = 0.0

    def propose(self, now: EmPoint) -> NoiseValues | None:
        """A point to try from ``now``, where the last pass was made; None where an EM step is next."""
        seen = self._see(now)
        if seen is None:
            return None
        if self._last is not None:
            self._remember(self._last, seen)
        self._last = seen
        step = self._direction(seen) if self._secants else None
        if step is None:
            return None
        wanted, plain = float(np.max(np.abs(step))), float(np.max(np.abs(seen.step)))
        self._size = min(wanted, self._longest)
        if self._size <= plain:
            self._longest = max(self._longest, GROWTH * plain)
            return None
        return self._run.unknowns.unpack(seen.z + step * (self._size / wanted), now.noise)

    def learn(self, tried: EmPoint | None) -> None:
        """What became of the proposed point; None where there was no pass, or none that ended."""
        if tried is not None and tried.accepted:
            self._longest = min(LAST, GROWTH * self._longest)
            return
        self._longest = SHRINKAGE * self._size
        seen = None if tried is None else self._see(tried)
        if seen is not None and self._last is not None:
            self._remember(self._last, seen)

    def _see(self, point: EmPoint) -> _Seen | None:
        """The point in coordinates; None where a covariance on its way to zero has no logarithm or inverse left."""
        u, statistics = self._run.unknowns, self._run.statistics
        assert statistics is not None
        try:
            z = u.pack(point.noise)
            score = score_of(statistics, point.noise, u)
            return _Seen(z, score.gradient, score.complete, u.pack(point.after) - z)
        except np.linalg.LinAlgError:
            return None

    def _remember(self, a: _Seen, b: _Seen) -> None:
        """The secant from a to b, if the score falls along it, as it does around a maximum."""
        s, y = b.z - a.z, a.gradient - b.gradient
        with np.errstate(over="ignore"):  # next to zero; infinity is no secant
            if np.isfinite(y @ y) and float(s @ y) > FLAT * float(np.linalg.norm(s) * np.linalg.norm(y)):
                self._secants.append((s, y))

    def _direction(self, seen: _Seen) -> Array | None:
        """(d,) the quasi-Newton step; None where it is no way up."""
        complete = seen.complete + np.diag(np.where(np.diag(seen.complete) > 0.0, 0.0, 1.0))
        q, shares = seen.gradient.copy(), []
        for s, y in reversed(self._secants):
            shares.append(float(s @ q) / float(s @ y))
            q -= shares[-1] * y
        s, y = self._secants[-1]
        try:
            of_q, of_y = np.linalg.solve(complete, np.column_stack([q, y])).T
        except np.linalg.LinAlgError:
            return None
        # The data hold no more than the noise itself: the scale is not below that of an EM step.
        step = max(1.0, float(s @ y) / float(y @ of_y)) * of_q
        for (s, y), share in zip(self._secants, reversed(shares), strict=True):
            step += (share - float(y @ step) / float(s @ y)) * s
        upwards = bool(np.all(np.isfinite(step))) and float(seen.gradient @ step) > 0.0
        return step if upwards else None

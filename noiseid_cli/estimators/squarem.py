"""SQUAREM: extrapolation through two EM steps (Varadhan & Roland, Scand. J. Statist. 35, 2008, scheme S3)."""

from __future__ import annotations

import numpy as np

from noiseid_cli.estimators.em_run import EmPoint
from noiseid_cli.estimators.unknowns import Unknowns
from noiseid_cli.models.noise import NoiseValues

# First bound on the length of a jump, and the factor by which the bound moves (as in the authors' package).
GROWTH = 4.0


class Squarem:
    """Two EM steps, then a jump along their parabola.

    The step length is bounded; the bound grows when it is reached with success, and shrinks at a rejection.
    """

    def __init__(self, unknowns: Unknowns) -> None:
        """For these unknowns."""
        self._unknowns = unknowns
        self._before: EmPoint | None = None
        self._length = 0.0
        self._longest = GROWTH

    def propose(self, now: EmPoint) -> NoiseValues | None:
        """A point to try from ``now``; None where an EM step is next.

        The first EM step leads from the point before to ``now``, the second is the one that ``now`` carries.
        """
        first, self._before = self._before, now
        if first is None:
            return None
        try:
            z0, z1, z2 = (self._unknowns.pack(n) for n in (first.noise, now.noise, now.after))
        except np.linalg.LinAlgError:
            # A covariance on its way to zero has no logarithm left to extrapolate.
            return None
        r, v = z1 - z0, z2 - 2.0 * z1 + z0
        curvature = float(np.linalg.norm(v))
        wanted = float(np.linalg.norm(r)) / curvature if curvature > 0.0 else 0.0
        self._length = min(wanted, self._longest)
        if self._length <= 1.0:
            # A length of 1 is the second EM step itself, which never needs a check.
            self._longest = max(self._longest, GROWTH)
            return None
        return self._unknowns.unpack(z0 + 2.0 * self._length * r + self._length * self._length * v, first.noise)

    def learn(self, reached: EmPoint | None) -> None:
        """What became of the proposed point: None where it was rejected."""
        if reached is None:
            self._longest = max(1.0, self._length / GROWTH)
            return
        self._before = None
        if self._length == self._longest:
            self._longest *= GROWTH

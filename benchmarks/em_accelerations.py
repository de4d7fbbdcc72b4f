"""Accelerations of EM that were tried beside the one that noiseid has; each proposes points as `em.Acceleration` says.

All work in the same free coordinates, under the same safeguard: a point where the log-likelihood falls is rejected,
and an EM step follows.
"""

from __future__ import annotations

import numpy as np

from noiseid_cli.estimators.em_run import EmPoint, EmRun
from noiseid_cli.models.noise import NoiseValues

Array = np.ndarray
# Bound on a step in any coordinate, for the schemes that bring none: the one that the quasi-Newton form begins with.
LONGEST = 2.0


class Scheme:
    """What the schemes share."""

    def __init__(self, run: EmRun) -> None:
        """For this run."""
        self.unknowns = run.unknowns

    def see(self, point: EmPoint) -> tuple[Array, Array]:
        """Coordinates of a point, and EM's step from it."""
        z = self.unknowns.pack(point.noise)
        return z, self.unknowns.pack(point.after) - z

    def moved(self, now: EmPoint, z: Array, step: Array, longest: float = np.inf) -> NoiseValues | None:
        """The point a bounded step away; None if the step is no number."""
        size = float(np.max(np.abs(step)))
        if not np.isfinite(size):
            return None
        return self.unknowns.unpack(z + step * min(1.0, longest / size) if size > 0.0 else z, now.noise)


class Squarem(Scheme):
    """A jump along the parabola of two EM steps (Varadhan & Roland, Scand. J. Statist. 35, 2008, scheme S3)."""

    growth = 4.0

    def __init__(self, run: EmRun) -> None:
        """For this run."""
        super().__init__(run)
        self.before: EmPoint | None = None
        self.length, self.longest = 0.0, self.growth

    def propose(self, now: EmPoint) -> NoiseValues | None:
        """After every second EM step."""
        first, self.before = self.before, now
        if first is None:
            return None
        (z, r), (_, step) = self.see(first), self.see(now)
        v = step - r
        curvature = float(np.linalg.norm(v))
        wanted = float(np.linalg.norm(r)) / curvature if curvature > 0.0 else 0.0
        self.length = min(wanted, self.longest)
        if self.length <= 1.0:
            self.longest = max(self.longest, self.growth)
            return None
        return self.moved(now, z, 2.0 * self.length * r + self.length**2 * v)

    def learn(self, tried: EmPoint | None) -> None:
        """The bound grows when it is reached with success, and shrinks at a rejection."""
        if tried is None or not tried.accepted:
            self.longest = max(1.0, self.length / self.growth)
            return
        self.before = None
        if self.length == self.longest:
            self.longest *= self.growth


class Anderson(Scheme):
    """DAAREM: Anderson mixing, restarted and damped (Henderson & Varadhan, J. Comput. Graph. Statist. 28, 2019)."""

    most, kappa, alpha = 10, 25, 1.2

    def __init__(self, run: EmRun) -> None:
        """For this run."""
        super().__init__(run)
        self.z: list[Array] = []
        self.f: list[Array] = []
        self.successes = 0
        self.of_cycle = -np.inf

    def propose(self, now: EmPoint) -> NoiseValues | None:
        """A mixture of the points of this cycle."""
        z, f = self.see(now)
        order = min(self.most, -(-z.size // 2))
        self.z.append(z)
        self.f.append(f)
        if len(self.z) > order + 1:
            if now.loglik < self.of_cycle:
                self.successes = max(self.successes - order, -2 * self.kappa)
            self.of_cycle = now.loglik
            self.z, self.f = [z], [f]
        if len(self.z) < 2:
            return None
        F, Z = np.diff(self.f, axis=0).T, np.diff(self.z, axis=0).T
        return self.moved(now, z, f - (Z + F) @ self.mixture(F, f))

    def mixture(self, F: Array, f: Array) -> Array:
        """Damped least squares: the squared length of the coefficients is a share of what it would be undamped."""
        U, s, Vt = np.linalg.svd(F, full_matrices=False)
        kept = s > 1e-14 * s[0]
        u, s, Vt = (U.T @ f)[kept], s[kept], Vt[kept]
        target = float(np.sum((u / s) ** 2)) / (1.0 + self.alpha ** (self.kappa - self.successes))
        low, high = 1e-16 * s[0] ** 2, 1e16 * s[0] ** 2
        for _ in range(100):
            middle = np.sqrt(low * high)
            low, high = (middle, high) if np.sum((s * u / (s**2 + middle)) ** 2) > target else (low, middle)
        mixture: Array = Vt.T @ (s * u / (s**2 + high))
        return mixture

    def learn(self, tried: EmPoint | None) -> None:
        """Success lessens the damping."""
        self.successes += tried is not None and tried.accepted


class Secants(Scheme):
    """Quasi-Newton with the secants of three pairs of EM steps (Zhou, Alexander & Lange, Stat. Comput. 21, 2011)."""

    most = 3

    def __init__(self, run: EmRun) -> None:
        """For this run."""
        super().__init__(run)
        self.before: EmPoint | None = None
        self.pairs: list[tuple[Array, Array]] = []

    def propose(self, now: EmPoint) -> NoiseValues | None:
        """After every second EM step."""
        first, self.before = self.before, now
        if first is None:
            return None
        (z, u), (_, v) = self.see(first), self.see(now)
        self.pairs = [*self.pairs, (u, v)][-self.most :]
        U, V = (np.array(side).T for side in zip(*self.pairs, strict=True))
        try:
            weights = np.linalg.solve(U.T @ U - U.T @ V, U.T @ u)
        except np.linalg.LinAlgError:
            return None
        return self.moved(now, z, u + V @ weights, LONGEST)

    def learn(self, tried: EmPoint | None) -> None:
        """A rejection leaves the last pair only."""
        if tried is None or not tried.accepted:
            self.pairs = self.pairs[-1:]
        else:
            self.before = None


class Broyden(Scheme):
    """Broyden's method for a zero of the EM step (Jamshidian & Jennrich, JRSS B 59, 1997, algorithm QN1)."""

    def __init__(self, run: EmRun) -> None:
        """For this run."""
        super().__init__(run)
        self.last: tuple[Array, Array] | None = None
        self.inverse = np.empty((0, 0))

    def propose(self, now: EmPoint) -> NoiseValues | None:
        """After every pass but the first."""
        z, f = self.see(now)
        if self.last is None:
            self.last, self.inverse = (z, f), -np.eye(z.size)
            return None
        s, change = z - self.last[0], self.inverse @ (f - self.last[1])
        along = float(s @ change)
        if abs(along) > 1e-12 * float(np.linalg.norm(s) * np.linalg.norm(change)):
            self.inverse = self.inverse + np.outer(s - change, s @ self.inverse) / along
        self.last = (z, f)
        return self.moved(now, z, -self.inverse @ f, LONGEST)

    def learn(self, tried: EmPoint | None) -> None:
        """A rejection begins it anew."""
        if tried is None or not tried.accepted:
            self.last = None

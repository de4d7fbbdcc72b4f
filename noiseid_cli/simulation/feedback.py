"""State feedback from an extended Kalman filter that knows the true model and noise."""

from __future__ import annotations

import numpy as np

from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.discretisation import workspace
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array
from noiseid_cli.simulation.rollout import advance


class StateFeedback:
    """u_k = -gain x^_k, with x^_k from the outputs up to sample k; a sample without outputs is predicted.

    Outputs may not depend on the input directly.

    Args:
        compiled: the model.
        dt: interval, s.
        gain: (nu, nx).
        law: Q, R, and the law of the first state in the first row of m0 and in P0.
    """

    def __init__(self, compiled: CompiledModel, dt: float, gain: Array, law: NoiseValues) -> None:
        self._compiled, self._dt, self._gain, self._law = compiled, dt, gain, law
        n, nv, ny = compiled.nx, compiled.nv, compiled.ny
        self._next, self._F, self._G = np.empty(n), np.empty((n, n)), np.empty((n, nv))
        self._h, self._H, self._work, self._still = np.empty(ny), np.empty((ny, n)), workspace(n, nv), np.zeros(nv)
        self.start()

    @property
    def reads(self) -> tuple[int, ...]:
        """All outputs."""
        return tuple(range(self._compiled.ny))

    def start(self) -> None:
        """Back to the law of the first state."""
        self._m, self._P = self._law.m0[0].copy(), self._law.P0.copy()

    def control(self, k: int, y: Array) -> Array:
        """(nu,) input of sample k; the filter moves on to sample k + 1."""
        c = self._compiled
        c.output_jacobian(self._m, np.zeros(c.nu), c.parameters, self._h, self._H)
        seen = np.isfinite(y)
        H, S = self._H[seen], self._H[seen] @ self._P @ self._H[seen].T + self._law.R[np.ix_(seen, seen)]
        K = np.linalg.solve(S, H @ self._P).T
        self._m = self._m + K @ (y[seen] - self._h[seen])
        left = np.eye(c.nx) - K @ H
        self._P = left @ self._P @ left.T + K @ self._law.R[np.ix_(seen, seen)] @ K.T
        u = np.ascontiguousarray(-self._gain @ self._m)
        advance(
            c.scheme, c.drift_jacobian, self._m, u, self._still, self._dt, c.parameters, self._next, self._F, self._G,
            self._work,
        )  # fmt: skip
        self._m = self._next.copy()
        self._P = self._F @ self._P @ self._F.T + self._G @ self._law.Q @ self._G.T
        return u

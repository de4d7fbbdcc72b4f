"""Random stable linear models with data, for the identities that hold for every one of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from noiseid_cli.models.linear import linear_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording


def random_covariance(rng, n):
    """A well-conditioned random covariance."""
    L = rng.normal(size=(n, n))
    return L @ L.T + 0.3 * np.eye(n)


@dataclass
class LinearCase:
    """A random linear model, noise values and one recording per test."""

    A: np.ndarray
    B: np.ndarray
    G: np.ndarray
    C: np.ndarray
    D: np.ndarray
    noise: NoiseValues
    recordings: tuple[Recording, ...]

    @property
    def model(self):
        return linear_model(self.A, self.G, self.C, self.B, self.D)


def random_case(seed, n=3, nv=2, ny=2, nu=1, lengths=(20,), missing=0.2):
    """Draw a case; ``missing`` is the share of outputs that are NaN."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A *= rng.uniform(0.5, 0.95) / np.max(np.abs(np.linalg.eigvals(A)))
    B, G = rng.normal(size=(n, nu)), rng.normal(size=(n, nv))
    C, D = rng.normal(size=(ny, n)), rng.normal(size=(ny, nu))
    Q, R, P0 = (random_covariance(rng, k) for k in (nv, ny, n))
    m0 = rng.normal(size=(len(lengths), n))
    recordings = []
    for i, N in enumerate(lengths):
        x = rng.multivariate_normal(m0[i], P0)
        u = rng.normal(size=(N, nu))
        y = np.empty((N, ny))
        for k in range(N):
            y[k] = C @ x + D @ u[k] + rng.multivariate_normal(np.zeros(ny), R)
            x = A @ x + B @ u[k] + G @ rng.multivariate_normal(np.zeros(nv), Q)
        y[rng.uniform(size=y.shape) < missing] = np.nan
        recordings.append(Recording(f"test-{i}", np.ones(N - 1), u, y))
    return LinearCase(A, B, G, C, D, NoiseValues(Q, R, m0, P0), tuple(recordings))

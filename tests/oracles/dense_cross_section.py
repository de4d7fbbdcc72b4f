"""Cross-sectional likelihood the obvious way: one Gaussian over all outputs of a test, derivatives by complex step.

Only for random stable models of a few samples: the covariance of integrated processes is too ill-conditioned.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from random_models import random_covariance

from noiseid_cli.estimators.cross_sectional.problem import Coordinates, CrossSection, Theta
from noiseid_cli.models.parametric import ParametricMatrices
from noiseid_cli.models.recording import Recording

NAMES = ("A", "B", "Q", "C", "D", "R")


@dataclass
class RandomFamily:
    """Every matrix is base + sum_a alpha_a slope_a; covariances stay positive for alpha > 0."""

    base: dict[str, np.ndarray]
    slope: dict[str, np.ndarray]

    def at(self, name, alpha, times):
        """The matrix at (complex) alpha, first ``times`` instants (constant matrices have one)."""
        M = self.base[name] + np.tensordot(alpha, self.slope[name], 1)
        return M[:times] if M.ndim == 3 else M

    def __call__(self, alpha, recording):
        N = recording.samples
        values, slopes = [], []
        for name in NAMES:
            times = N - 1 if name in "ABQ" else N
            values.append(self.at(name, alpha, max(times, 1)))
            slopes.append(self.slope[name][:, : max(times, 1)])
        return ParametricMatrices(*values, self.at("S_a", alpha, 0), *slopes, self.slope["S_a"])


def random_family(rng, nx=4, nu=1, ny=2, na=2, times=15, varying=True):
    """Draw a family; with ``varying`` A, C, Q change from sample to sample. All matrices depend on alpha."""
    shapes = {"A": (nx, nx), "B": (nx, nu), "C": (ny, nx), "D": (ny, nu)}
    base, slope = {}, {}
    for name, shape in shapes.items():
        length = times if varying and name in "AC" else 1
        base[name] = rng.normal(size=(length, *shape))
        slope[name] = 0.3 * rng.normal(size=(na, length, *shape))
    base["A"] *= 0.35
    slope["A"] *= 0.3
    for name, n in (("Q", nx), ("R", ny), ("S_a", nx)):
        length = times if varying and name == "Q" else 1
        draw = [[random_covariance(rng, n) for _ in range(length)] for _ in range(1 + na)]
        base[name], slope[name] = 0.2 * np.array(draw[0]), 0.2 * np.array(draw[1:])
    base["S_a"], slope["S_a"] = base["S_a"][0], slope["S_a"][:, 0]
    return RandomFamily(base, slope)


def random_tests(seed, lengths=(15, 9, 12), nb=3, missing=0.2, structure="full", **sizes):
    """A cross-section with unequal tests, missing rows and samples, a theta, and coordinates."""
    rng = np.random.default_rng(seed)
    family = random_family(rng, times=max(lengths), **sizes)
    nx, nu, ny = family.base["A"].shape[-1], family.base["B"].shape[-1], family.base["C"].shape[-2]
    na = len(family.slope["A"])
    Sigma = random_covariance(rng, nb)
    theta = Theta(
        rng.normal(size=nb), Sigma if structure == "full" else np.diag(np.diag(Sigma)), rng.uniform(0.3, 0.8, size=na)
    )
    recordings = []
    maps = tuple(rng.normal(size=(nx, nb)) for _ in lengths)
    for N, T in zip(lengths, maps, strict=True):
        u = rng.normal(size=(N, nu))
        m, S, _ = dense_moments(family, Recording("", np.ones(N - 1), u, np.zeros((N, ny))), T, theta)
        y = rng.multivariate_normal(m.real, S.real).reshape(N, ny)
        y[rng.uniform(size=y.shape) < missing] = np.nan
        if missing and N > 4:
            y[3] = np.nan
        recordings.append(Recording(f"test-{len(recordings)}", np.ones(N - 1), u, y))
    return CrossSection(family, tuple(recordings), maps), theta, Coordinates(nb, na, structure, log_alpha=False)


def dense_moments(family, recording, T, theta):
    """Mean and covariance of the observed outputs; complex theta is allowed."""
    N = recording.samples
    alpha = theta.alpha
    A, B, Q, C, D, R = (family.at(name, alpha, max(N, 1)) for name in NAMES)

    def now(M, k):
        return M[min(k, len(M) - 1)]

    nx, ny = C.shape[-1], C.shape[-2]
    # x_k as a map of (x_0, w_0, ..., w_{N-2}); plain transposes keep everything analytic.
    size = N * nx
    cov = np.zeros((size, size), dtype=complex)
    cov[:nx, :nx] = family.at("S_a", alpha, 0) + T @ theta.Sigma @ T.T
    mean, rows = [T @ theta.mu], [np.eye(nx, size, dtype=complex)]
    for k in range(N - 1):
        mean.append(now(A, k) @ mean[-1] + now(B, k) @ recording.u[k])
        rows.append(now(A, k) @ rows[-1] + np.eye(nx, size, (k + 1) * nx))
        cov[(k + 1) * nx : (k + 2) * nx, (k + 1) * nx : (k + 2) * nx] = now(Q, k)
    H = np.vstack([now(C, k) @ rows[k] for k in range(N)])
    m = np.concatenate([now(C, k) @ mean[k] + now(D, k) @ recording.u[k] for k in range(N)])
    S = H @ cov @ H.T
    for k in range(N):
        S[k * ny : (k + 1) * ny, k * ny : (k + 1) * ny] += now(R, k)
    seen = ~np.isnan(recording.y.ravel())
    return m[seen], S[np.ix_(seen, seen)], recording.y.ravel()[seen]


def unpack_complex(coordinates, vector):
    """Theta from a complex vector."""
    Sigma = np.zeros((coordinates.nb, coordinates.nb), dtype=complex)
    Sigma[coordinates.rows, coordinates.columns] = vector[coordinates.nb : coordinates.n_beta]
    Sigma[coordinates.columns, coordinates.rows] = vector[coordinates.nb : coordinates.n_beta]
    return Theta(vector[: coordinates.nb], Sigma, vector[coordinates.n_beta :])


def dense_evaluation(tests, i, theta, coordinates):
    """The paper's l without n m/2 log 2 pi, gradient by complex step, and the expected Fisher information of test i."""
    vector = coordinates.pack(theta).astype(complex)
    recording, T = tests.recordings[i], tests.maps[i]

    def moments(v):
        return dense_moments(tests.family, recording, T, unpack_complex(coordinates, v))

    def value(v):
        m, S, y = moments(v)
        return 0.5 * (np.log(np.linalg.det(S)) + (y - m) @ np.linalg.solve(S, y - m))

    h = 1e-30
    steps = vector + 1j * h * np.eye(len(vector))
    gradient = np.array([value(v).imag / h for v in steps])
    _, S, _ = moments(vector)
    weight = np.linalg.inv(S.real)
    dm, dS = [], []
    for v in steps:
        m, S, _ = moments(v)
        dm.append(m.imag / h)
        dS.append(weight @ S.imag / h)
    fisher = np.array(dm) @ weight @ np.array(dm).T + 0.5 * np.einsum("aij,bji->ab", dS, dS)
    return value(vector).real, gradient, fisher

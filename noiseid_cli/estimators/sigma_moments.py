"""EM's second moments with sigma points: expectations of v v' and e e' under the smoothed distributions.

Where the extended form puts one linearisation, these take the points of the smoothed x_k through F1, F2^+ and h.
x_{k+1} given x_k is Gaussian and enters the residual x_{k+1} - F1(x_k) linearly, so that it is integrated exactly:

    v | x_k ~ (F2^+ r, F2^+ S F2^+'),  r = E[x_{k+1} | x_k] - F1(x_k),  S = Cov(x_{k+1} | x_k, y).

The gain F2 may depend on the state: F2^+ is taken at each point (Gasperin & Juricic 2011, IFAC 44:1, for EM with the
unscented smoother and a constant gain).
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from noiseid_cli.estimators.measurement_moment import add_sample
from noiseid_cli.filters.ekf import cube
from noiseid_cli.filters.linalg import add_products, left_solve
from noiseid_cli.filters.sigma_points import draw
from noiseid_cli.filters.sigma_rows import split
from noiseid_cli.models.discretisation import transition, workspace
from noiseid_cli.models.jit import kernel
from noiseid_cli.models.signatures import DriftJacobian, Output, matrix, vector


@kernel(
    types.int64(
        types.int64, DriftJacobian, vector, vector, matrix, types.float64, types.float64, matrix, cube, cube, cube,
        matrix,
    ),
    allocates=True,
)  # fmt: skip
def process_sigma(scheme, drift_jacobian, p, dt, u, eta, centre, m, U, T, V, sum_v):  # type: ignore[no-untyped-def]
    """Add E[v v' | y] to sum_v. Returns the sample where F2 lacks full column rank, or -1.

    Args:
        scheme, drift_jacobian, p, dt, u: the model and the test's intervals and inputs.
        eta, centre: spread of the points and their pair centre, see ``sigma_rows``.
        m, U, T, V: of ``SigmaSmoothed``.
        sum_v: (nv, nv), updated.
    """
    N, n = m.shape
    nv = sum_v.shape[0]
    if nv > n:
        return 0
    points = 2 * n + 1
    columns = nv * (1 + n)
    X = np.empty((points, n))
    values = np.empty((points, columns))
    mean, rows = np.empty(columns), np.empty((2 * n, columns))
    x_next, F, G = np.empty(n), np.empty((n, n)), np.empty((n, nv))
    work = workspace(n, nv)
    L, pivot_column = np.empty((n, nv + 1 + n)), np.empty(nv, dtype=np.int64)
    for k in range(N - 1):
        draw(m[k], U[k], eta, X)
        for i in range(points):
            transition(scheme, drift_jacobian, X[i], u[k], dt[k], p, x_next, F, G, work)
            for r in range(n):
                step = 0.0
                if 1 <= i <= n:
                    step = eta * T[k, i - 1, r]
                elif i > n:
                    step = -eta * T[k, i - 1 - n, r]
                for c in range(nv):
                    L[r, c] = G[r, c]
                L[r, nv] = (m[k + 1, r] - x_next[r]) + step
                for j in range(n):
                    L[r, nv + 1 + j] = V[k, j, r]
            if not left_solve(L, nv, nv + 1 + n, pivot_column):
                return k
            for c in range(nv):
                for j in range(1 + n):
                    values[i, j * nv + c] = L[c, nv + j]
        split(values, eta, centre, mean, rows)
        # The mean, then the spread of what one row each of r and V gives.
        add_products(mean.reshape(1 + n, nv), 1 + n, sum_v)
        for r in range(2 * n):
            add_products(rows[r].reshape(1 + n, nv), 1 + n, sum_v)
    return -1


@kernel(
    types.void(
        Output, vector, matrix, matrix, types.float64, types.float64, matrix, cube, matrix, types.int64[::1],
        matrix, vector,
    ),
    allocates=True,
)  # fmt: skip
def measurement_sigma(output, p, u, y, eta, centre, m, U, UR, block_of, sum_e, samples):  # type: ignore[no-untyped-def]
    """Add E[e e' | y], completed where outputs are missing, as ``measurement_moment.measurement`` does."""
    N, n = m.shape
    ny = y.shape[1]
    points = 2 * n + 1
    X, Y = np.empty((points, n)), np.empty((points, ny))
    y_hat, D = np.empty(ny), np.empty((2 * n, ny))
    seen = np.empty(ny, dtype=np.bool_)
    block = np.empty(ny, dtype=np.int64)
    E = np.empty((points + ny, ny))
    W, w = np.empty((ny, ny)), np.empty(ny)
    for k in range(N):
        any_seen = False
        for i in range(ny):
            seen[i] = not math.isnan(y[k, i])
            any_seen = any_seen or seen[i]
        if not any_seen:
            continue
        draw(m[k], U[k], eta, X)
        for i in range(points):
            output(X[i], u[k], p, Y[i])
        split(Y, eta, centre, y_hat, D)
        for i in range(ny):
            for r in range(2 * n):
                E[r, i] = D[r, i] if seen[i] else 0.0
            E[2 * n, i] = y[k, i] - y_hat[i] if seen[i] else 0.0
        add_sample(E, points, seen, UR, block_of, block, sum_e, samples, W, w)

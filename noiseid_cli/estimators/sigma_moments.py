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
from noiseid_cli.models.jit import kernel, routine
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
    n, nv = m.shape[1], sum_v.shape[0]
    if nv > n:
        return 0
    points, columns = 2 * n + 1, nv * (1 + n)
    return _process_steps(
        scheme, drift_jacobian, p, dt, u, eta, centre, m, U, T, V, sum_v,
        np.empty((points, n)), np.empty((points, columns)), np.empty(columns), np.empty((2 * n, columns)),
        np.empty(n), np.empty((n, n)), np.empty((n, nv)), workspace(n, nv),
        np.empty((n, nv + 1 + n)), np.empty(nv, dtype=np.int64), np.empty((1 + n, nv)),
    )  # fmt: skip


@routine
def _process_steps(  # type: ignore[no-untyped-def]
    scheme, drift_jacobian, p, dt, u, eta, centre, m, U, T, V, sum_v,
    X, values, mean, rows, x_next, F, G, work, L, pivot_column, E,
):  # fmt: skip
    """The loop of ``process_sigma``; from X on, all is scratch."""
    N, n = m.shape
    nv = sum_v.shape[0]
    points = 2 * n + 1
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
        _add(mean, E, sum_v)
        for r in range(2 * n):
            _add(rows[r], E, sum_v)
    return -1


@routine
def _add(row, E, sum_v):  # type: ignore[no-untyped-def]
    """Add E'E to sum_v, where E (1 + n, nv) takes its entries from the row."""
    nv = E.shape[1]
    for i in range(E.shape[0]):
        for c in range(nv):
            E[i, c] = row[i * nv + c]
    add_products(E, E.shape[0], sum_v)


@kernel(
    types.void(
        Output, vector, matrix, matrix, types.float64, types.float64, matrix, cube, matrix, types.int64[::1],
        matrix, vector,
    ),
    allocates=True,
)  # fmt: skip
def measurement_sigma(output, p, u, y, eta, centre, m, U, UR, block_of, sum_e, samples):  # type: ignore[no-untyped-def]
    """Add E[e e' | y], completed where outputs are missing, as ``measurement_moment.measurement`` does."""
    n, ny = m.shape[1], y.shape[1]
    points = 2 * n + 1
    _measurement_steps(
        output, p, u, y, eta, centre, m, U, UR, block_of, sum_e, samples,
        np.empty((points, n)), np.empty((points, ny)), np.empty(ny), np.empty((2 * n, ny)),
        np.empty(ny, dtype=np.bool_), np.empty(ny, dtype=np.int64), np.empty((points + ny, ny)),
        np.empty((ny, ny)), np.empty(ny),
    )  # fmt: skip


@routine
def _measurement_steps(  # type: ignore[no-untyped-def]
    output, p, u, y, eta, centre, m, U, UR, block_of, sum_e, samples, X, Y, y_hat, D, seen, block, E, W, w
):
    """The loop of ``measurement_sigma``; from X on, all is scratch."""
    N, n = m.shape
    ny = y.shape[1]
    points = 2 * n + 1
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

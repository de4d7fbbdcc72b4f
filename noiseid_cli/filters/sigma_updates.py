"""The updates of the sigma-point filter in square-root array form, one step of each.

Each update and each prediction is one orthogonal triangularisation of a stack of rows, see ``filters.sigma_rows``.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from noiseid_cli.filters.ekf_steps import condition
from noiseid_cli.filters.linalg import echelon, triangularise
from noiseid_cli.filters.sigma_rows import split
from noiseid_cli.models.arrays import copy, copy_matrix
from noiseid_cli.models.discretisation import transition
from noiseid_cli.models.jit import allocating, routine


class Scratch(NamedTuple):
    """Arrays that the steps of one filter work in."""

    X: Any  # (2n + 1, n) points
    Y: Any  # (2n + 1, ny) outputs at them
    D: Any  # (2n, ny) factor rows of the outputs
    y_hat: Any  # (ny,)
    W: Any  # (ny + 2n, ny + n)
    e: Any  # (ny,)
    values: Any  # (2n + 1, n + nv n), see ``joint``
    mean: Any  # (n + nv n,)
    rows: Any  # (2n, n + nv n)
    W_pred: Any  # (2n + nv + 2n nv, 2n)
    pivot_column: Any  # (n,)
    x_next: Any  # (n,)
    F: Any  # (n, n)
    G: Any  # (n, nv)


@allocating
def scratch(n, nv, ny):  # type: ignore[no-untyped-def]
    """Make the scratch arrays."""
    columns = n + nv * n
    return Scratch(
        np.empty((2 * n + 1, n)), np.empty((2 * n + 1, ny)), np.empty((2 * n, ny)), np.empty(ny),
        np.empty((ny + 2 * n, ny + n)), np.empty(ny), np.empty((2 * n + 1, columns)), np.empty(columns),
        np.empty((2 * n, columns)), np.empty((2 * n + nv + 2 * n * nv, 2 * n)), np.empty(n, dtype=np.int64),
        np.empty(n), np.empty((n, n)), np.empty((n, nv)),
    )  # fmt: skip


@routine
def correct(m, U, D, innovation, UR, m_out, U_out, W, e):  # type: ignore[no-untyped-def]
    """Measurement update: one triangularisation of [UR 0; D_odd U; D_even 0] over the observed outputs.

    Args:
        m, U: predicted mean (n,) and factor (n, n).
        D: (2n, ny) factor rows of h at the points; innovation: (ny,), NaN where missing; UR: (ny, ny).
        m_out, U_out: outputs, may not alias U.
        W, e: scratch (ny + 2n, ny + n), (ny,).

    Returns:
        The log-likelihood of the innovation, NaN if its covariance is singular.
    """
    ny, n = UR.shape[0], m.shape[0]
    q = 0
    for i in range(ny):
        if not math.isnan(innovation[i]):
            copy(UR[:, i], W[:ny, q])
            copy(D[:, i], W[ny:, q])
            e[q] = innovation[i]
            q += 1
    if q == 0:
        copy(m, m_out)
        copy_matrix(U, U_out)
        return 0.0
    for c in range(n):
        for r in range(ny + 2 * n):
            W[r, q + c] = U[r - ny, c] if ny <= r <= ny + c else 0.0
    return condition(W, ny + 2 * n, q, m, e, m_out, U_out)


@routine
def joint(values, UQ, eta, centre, U, m_next, U_next, gain, C, mean, rows, W, pivot_column):  # type: ignore[no-untyped-def]
    """Time update from the values of [F1, F2 UQ'] at the points, with the smoother's gain and factor.

    One triangularisation of [O U; E 0; (E F2 UQ')' 0; spread of F2 UQ' 0], O and E the odd and even rows of F1.

    Args:
        values: (2n + 1, n + nv n), per point F1 and the columns of F2 UQ'.
        UQ: (nv, nv); eta, centre: see ``sigma_rows``; U: (n, n) factor of x_k.
        m_next, U_next, gain, C: outputs (n,), (n, n), (n, n), (n, n).
        mean, rows, W, pivot_column: scratch.

    Returns:
        The rank of the predicted covariance.
    """
    n, nv = U.shape[0], UQ.shape[0]
    split(values, eta, centre, mean, rows)
    count = 2 * n + nv
    W[:, :] = 0.0
    for c in range(n):
        m_next[c] = mean[c]
        for r in range(2 * n):
            W[r, c] = rows[r, c]
        for r in range(c + 1):
            W[r, n + c] = U[r, c]
        for j in range(nv):
            W[2 * n + j, c] = mean[n + j * n + c]
    # A gain that is the same at all points has no spread: its rows are left out.
    for j in range(nv):
        for r in range(2 * n):
            size = 0.0
            for c in range(n):
                size += abs(rows[r, n + j * n + c])
            if size > 0.0:
                for c in range(n):
                    W[count, c] = rows[r, n + j * n + c]
                count += 1
    rank = echelon(W, count, 2 * n, n, pivot_column)
    for r in range(n):
        for c in range(n):
            U_next[r, c] = W[r, c] if r < rank else 0.0
    gain[:, :] = 0.0
    for i in range(rank - 1, -1, -1):
        pivot = pivot_column[i]
        for j in range(n):
            total = W[i, n + j]
            for c in range(i + 1, rank):
                total -= W[i, pivot_column[c]] * gain[j, pivot_column[c]]
            gain[j, pivot] = total / W[i, pivot]
    # What x_{k+1} leaves open of x_k stands below.
    left = count - rank
    for r in range(left):
        for c in range(n):
            W[r, c] = W[rank + r, n + c]
    triangularise(W, left, n, n)
    for r in range(n):
        for c in range(n):
            C[r, c] = W[r, c] if r <= c and r < left else 0.0
    return rank


@routine
def propagate(scheme, drift_jacobian, X, u, dt, p, UQ, x_next, F, G, values, work):  # type: ignore[no-untyped-def]
    """Write F1 and the columns of F2 UQ' at each of the points X to ``values``, see ``joint``."""
    n, nv = G.shape
    for i in range(X.shape[0]):
        transition(scheme, drift_jacobian, X[i], u, dt, p, x_next, F, G, work)
        for r in range(n):
            values[i, r] = x_next[r]
            for j in range(nv):
                total = 0.0
                for c in range(j, nv):
                    total += G[r, c] * UQ[j, c]
                values[i, n + j * n + r] = total

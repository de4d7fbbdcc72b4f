"""Second moment of the process noise given the data, accumulated as a triangular factor sample by sample."""

from __future__ import annotations

import numpy as np
from numba import types

from noiseid_cli.filters.ekf import cube
from noiseid_cli.filters.linalg import absorb, left_solve, rows_of
from noiseid_cli.models.discretisation import transition, workspace
from noiseid_cli.models.jit import kernel, routine
from noiseid_cli.models.signatures import DriftJacobian, matrix, vector


@kernel(types.void(matrix, matrix, cube, cube, cube, matrix))
def process_filtered(m_pred, m, U, gain, C, U_v):  # type: ignore[no-untyped-def]
    """Add E[v v' | y] under the filter's linearisation: the smoother's own posterior of v_k."""
    N, n = m.shape
    nv = U_v.shape[0]
    rows = C.shape[1]
    W = np.empty((nv + rows + n + 1, nv))
    w = np.empty(nv)
    for k in range(N - 1):
        for c in range(nv):
            for r in range(rows):
                W[nv + r, c] = C[k, r, n + c]
            for r in range(n):
                total = 0.0
                for j in range(r, n):
                    total += U[k + 1, r, j] * gain[k, n + c, j]
                W[nv + rows + r, c] = total
            total = 0.0
            for j in range(n):
                total += gain[k, n + c, j] * (m[k + 1, j] - m_pred[k + 1, j])
            W[nv + rows + n, c] = total
        absorb(U_v, rows + n + 1, W, w)


@routine
def remainder(J, X, D):  # type: ignore[no-untyped-def]
    """Write I - J X to D, of X the first rows."""
    n = np.uint64(D.shape[0])
    for i in range(n):
        for c in range(n):
            D[i, c] = 1.0 if i == c else 0.0
        for j in range(n):
            a = J[i, j]
            for c in range(n):
                D[i, c] -= a * X[j, c]


@kernel(
    types.int64(types.int64, DriftJacobian, vector, vector, matrix, matrix, cube, cube, cube, matrix),
)  # fmt: skip
def process_smoothed(scheme, drift_jacobian, p, dt, u, m, U, gain, C, U_v):  # type: ignore[no-untyped-def]
    """Add F2^+ M F2^+' of the paper's M-step, J1 and F2 taken at the smoothed states.

    M = (-J1 I) P^xi (-J1 I)' + r r' has the rows -C_x J1', U_{k+1} (I - J1 X)' and r'; F2^+ is applied by a
    triangularisation of [F2, rows'] and back-substitution. Returns the sample where F2 lacks full column rank, or -1.
    """
    N, n = m.shape
    nv = U_v.shape[0]
    if nv > n:
        return 0
    rows = C.shape[1]
    total_rows = rows + n + 1
    x_next = np.empty(n)
    J1 = np.empty((n, n))
    F2 = np.empty((n, nv))
    work = workspace(n, nv)
    D, V = np.empty((n, n)), np.empty((n, n))
    L = np.empty((n, nv + total_rows))
    w = np.empty(nv + total_rows)
    W = np.empty((nv + total_rows, nv))
    for k in range(N - 1):
        transition(scheme, drift_jacobian, m[k], u[k], dt[k], p, x_next, J1, F2, work)
        for i in range(n):
            for c in range(nv):
                L[i, c] = F2[i, c]
            for r in range(rows):
                total = 0.0
                for j in range(n):
                    total -= C[k, r, j] * J1[i, j]
                L[i, nv + r] = total
            L[i, nv + rows + n] = m[k + 1, i] - x_next[i]
        # U_{k+1} (I - J1 X)'.
        remainder(J1, gain[k], D)
        rows_of(U[k + 1], D, 0, n, V, 0, 0)
        for i in range(n):
            for r in range(n):
                L[i, nv + rows + r] = V[r, i]
        if not left_solve(L, nv, nv + total_rows, W[nv:], w):
            return k
        absorb(U_v, total_rows, W, w)
    return -1

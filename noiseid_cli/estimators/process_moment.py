"""Second moment of the process noise given the data, summed over the steps.

Each step gives rows whose products are added up: nothing is subtracted, so that the sum is symmetric and positive
semidefinite. Where steps are equal (see ``filters.rest``) only the row of the mean is new.
"""

from __future__ import annotations

import numpy as np
from numba import types

from noiseid_cli.filters.ekf import cube
from noiseid_cli.filters.linalg import add_products, left_solve, rows_of
from noiseid_cli.filters.rest import same
from noiseid_cli.models.discretisation import transition, workspace
from noiseid_cli.models.jit import kernel, routine
from noiseid_cli.models.signatures import DriftJacobian, matrix, vector


@routine
def _equal_step(k, U, gain, C):  # type: ignore[no-untyped-def]
    """Whether the smoother's covariances of step k are those of the step before."""
    return k > 0 and same(gain[k], gain[k - 1]) and same(C[k], C[k - 1]) and same(U[k + 1], U[k])


@kernel(types.void(matrix, matrix, cube, cube, cube, matrix))
def process_filtered(m_pred, m, U, gain, C, sum_v):  # type: ignore[no-untyped-def]
    """Add E[v v' | y] under the filter's linearisation: the smoother's own posterior of v_k."""
    N, n = m.shape
    nv = sum_v.shape[0]
    rows = C.shape[1]
    W, spread = np.empty((rows + n, nv)), np.empty((nv, nv))
    mean = np.empty((1, nv))
    for k in range(N - 1):
        if not _equal_step(k, U, gain, C):
            for r in range(rows):
                for c in range(nv):
                    W[r, c] = C[k, r, n + c]
            rows_of(U[k + 1], gain[k], n, nv, W, rows, 0)
            spread[:] = 0.0
            add_products(W, rows + n, spread)
        for c in range(nv):
            mean[0, c] = 0.0
            for j in range(n):
                mean[0, c] += gain[k, n + c, j] * (m[k + 1, j] - m_pred[k + 1, j])
        sum_v += spread
        add_products(mean, 1, sum_v)


@routine
def left_inverse(F2, A, X, w, L):  # type: ignore[no-untyped-def]
    """Write F2^+ (nv, n) to L; returns whether F2 (n, nv) has full column rank. A, X, w are scratch."""
    n, nv = F2.shape
    for i in range(n):
        for c in range(nv):
            A[i, c] = F2[i, c]
        for j in range(n):
            A[i, nv + j] = 1.0 if i == j else 0.0
    if not left_solve(A, nv, nv + n, X, w):
        return False
    for c in range(nv):
        for i in range(n):
            L[c, i] = X[i, c]
    return True


@routine
def _spread(L, J1, X, U, C, B, D, W, total):  # type: ignore[no-untyped-def]
    """Write F2^+ (-J1 I) P^xi (-J1 I)' F2^+' to ``total``: products of the rows -C_x (L J1)' and U (L - L J1 X)'."""
    nv, n = np.uint64(L.shape[0]), np.uint64(L.shape[1])
    rows = np.uint64(C.shape[0])
    for c in range(nv):
        for j in range(n):
            B[c, j] = 0.0
            D[c, j] = L[c, j]
        for i in range(n):
            a = L[c, i]
            if a != 0.0:
                for j in range(n):
                    B[c, j] += a * J1[i, j]
        for i in range(n):
            a = B[c, i]
            for j in range(n):
                D[c, j] -= a * X[i, j]
        for r in range(rows):
            product = 0.0
            for j in range(n):
                product -= C[r, j] * B[c, j]
            W[r, c] = product
    rows_of(U, D, 0, nv, W, rows, 0)
    total[:] = 0.0
    add_products(W, rows + n, total)


@kernel(
    types.int64(types.int64, DriftJacobian, vector, vector, matrix, matrix, cube, cube, cube, matrix),
)  # fmt: skip
def process_smoothed(scheme, drift_jacobian, p, dt, u, m, U, gain, C, sum_v):  # type: ignore[no-untyped-def]
    """Add F2^+ M F2^+' of the paper's M-step, J1 and F2 taken at the smoothed states.

    M = (-J1 I) P^xi (-J1 I)' + r r', r = x_{k+1} - F1(x_k) at the smoothed means. Returns the sample where F2 lacks
    full column rank, or -1.
    """
    N, n = m.shape
    nv = sum_v.shape[0]
    if nv > n:
        return 0
    rows = C.shape[1]
    x_next, mean = np.empty(n), np.empty((1, nv))
    # Jacobians and gains of this step and of the one before, in turns.
    J, G = np.empty((2, n, n)), np.empty((2, n, nv))
    work = workspace(n, nv)
    A, X, w, L = np.empty((n, nv + n)), np.empty((n, nv)), np.empty(nv + n), np.empty((nv, n))
    B, D, W, spread = np.empty((nv, n)), np.empty((nv, n)), np.empty((rows + n, nv)), np.empty((nv, nv))
    for k in range(N - 1):
        J1, F2, J1_before, F2_before = J[k % 2], G[k % 2], J[1 - k % 2], G[1 - k % 2]
        transition(scheme, drift_jacobian, m[k], u[k], dt[k], p, x_next, J1, F2, work)
        equal = k > 0 and same(F2, F2_before)
        if not equal and not left_inverse(F2, A, X, w, L):
            return k
        if not (equal and same(J1, J1_before) and _equal_step(k, U, gain, C)):
            _spread(L, J1, gain[k], U[k + 1], C[k], B, D, W, spread)
        for c in range(nv):
            mean[0, c] = 0.0
            for i in range(n):
                mean[0, c] += L[c, i] * (m[k + 1, i] - x_next[i])
        sum_v += spread
        add_products(mean, 1, sum_v)
    return -1

"""Second moment of the process noise given the data: what one step adds to the sum.

Rows are multiplied and added up: nothing is subtracted, so that the sum is symmetric and positive semidefinite.
"""

from __future__ import annotations

import numpy as np

from noiseid_cli.filters.linalg import add_products, left_solve, rows_of
from noiseid_cli.models.jit import routine


@routine
def add_mean(L, r, row, sum_v):  # type: ignore[no-untyped-def]
    """Add (L r)(L r)' of L (nv, n) and r (n,) to sum_v; row (1, nv) is scratch."""
    nv, n = L.shape
    for c in range(nv):
        row[0, c] = 0.0
        for j in range(n):
            row[0, c] += L[c, j] * r[j]
    add_products(row, 1, sum_v)


@routine
def spread_filtered(U_next, gain, C, W, total):  # type: ignore[no-untyped-def]
    """Write Cov(v_k | y) under the filter's linearisation, the smoother's own posterior, to ``total``.

    Args:
        U_next: (n, n) smoothed factor at k + 1; gain: (n + nv, n) and C: (rows, n + nv) of the step.
        W: scratch (rows + n, nv).
    """
    nv, n = total.shape[0], U_next.shape[0]
    rows = C.shape[0]
    for r in range(rows):
        for c in range(nv):
            W[r, c] = C[r, n + c]
    rows_of(U_next, gain, n, nv, W, rows, 0)
    total[:] = 0.0
    add_products(W, rows + n, total)


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
def spread_smoothed(L, J1, U_next, gain, C, B, D, W, total):  # type: ignore[no-untyped-def]
    """Write L (-J1 I) P^xi (-J1 I)' L' of the paper's M-step, L = F2^+, to ``total``.

    It is the sum of products of the rows -C_x (L J1)' and U_next (L - L J1 X)'.

    Args:
        L: (nv, n); J1: (n, n); U_next, gain, C: as in ``spread_filtered``.
        B, D, W: scratch (nv, n), (nv, n), (rows + n, nv).
    """
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
                D[c, j] -= a * gain[i, j]
        for r in range(rows):
            product = 0.0
            for j in range(n):
                product -= C[r, j] * B[c, j]
            W[r, c] = product
    rows_of(U_next, D, 0, nv, W, rows, 0)
    total[:] = 0.0
    add_products(W, rows + n, total)

"""Second moment of the measurement noise given the data, summed over the samples.

As for the process noise, products of rows are added up, and where samples are equal only the row of the mean is new.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from noiseid_cli.filters.ekf import cube
from noiseid_cli.filters.linalg import add_products, rows_of, triangularise
from noiseid_cli.filters.rest import same
from noiseid_cli.models.arrays import copy, copy_matrix
from noiseid_cli.models.jit import kernel, routine
from noiseid_cli.models.signatures import OutputJacobian, matrix, vector

SMOOTHED, FILTERED = 0, 1
LINEARISATIONS = {"smoothed": SMOOTHED, "filtered": FILTERED}


@routine
def _complete(UR, block, seen, E, rows, W, w):  # type: ignore[no-untyped-def]
    """Fill the missing outputs of one block of E by their expectation given the seen ones, under e ~ N(0, R).

    E has ``rows`` rows; as many rows as there are missing outputs are added, the factor of what stays open.
    Returns the new number of rows. ``block`` lists the outputs of the block, ``seen`` says which were measured.
    """
    ny = UR.shape[0]
    q = 0
    for i in block:
        if seen[i]:
            for r in range(ny):
                W[r, q] = UR[r, i]
            q += 1
    p = q
    for i in block:
        if not seen[i]:
            for r in range(ny):
                W[r, p] = UR[r, i]
            p += 1
    # [R_oo factor, its product with R_om; 0, factor of R_mm given o].
    triangularise(W, ny, p, p, w)
    for r in range(rows):
        for a in range(q):
            w[a] = 0.0
        a = 0
        for i in block:
            if seen[i]:
                w[a] = E[r, i]
                for b in range(a):
                    w[a] -= W[b, a] * w[b]
                w[a] /= W[a, a]
                a += 1
        c = q
        for i in block:
            if not seen[i]:
                E[r, i] = 0.0
                for a in range(q):
                    E[r, i] += w[a] * W[a, c]
                c += 1
    for r in range(q, p):
        for j in range(ny):
            E[rows, j] = 0.0
        c = q
        for i in block:
            if not seen[i]:
                E[rows, i] = W[r, c]
                c += 1
        rows += 1
    return rows


@routine
def add_sample(E, rows, seen, UR, block_of, block, sum_e, samples, W, w):  # type: ignore[no-untyped-def]
    """Complete E block by block and add its products to sum_e; a block without a measured output is left out.

    Args:
        E: (>= rows + ny, ny), factor rows of the errors of one sample, zero where an output is missing; overwritten.
        seen: (ny,) which outputs were measured; UR: (ny, ny) factor of R; block_of: (ny,) block of each output.
        block, W, w: scratch (ny,), (ny, ny), (ny,).
        sum_e, samples: updated, see ``Statistics``.
    """
    ny = UR.shape[0]
    for b in range(ny):
        size = 0
        count = 0
        for i in range(ny):
            if block_of[i] == b:
                block[size] = i
                size += 1
                count += 1 if seen[i] else 0
        if count == 0:
            continue
        for i in block[:size]:
            samples[i] += 1.0
        if count < size:
            rows = _complete(UR, block[:size], seen, E, rows, W, w)
    add_products(E, rows, sum_e)


@kernel(
    types.void(
        OutputJacobian, vector, matrix, matrix, matrix, cube, matrix, matrix, cube, matrix,
        types.int64[::1], types.int64, matrix, vector,
    ),
)  # fmt: skip
def measurement(  # type: ignore[no-untyped-def]
    output_jacobian, p, u, y, m_pred, H_pred, innovation, m, U, UR, block_of, linearisation, sum_e, samples
):
    """Add E[e e' | y]: rows U_k H' and the residual, completed where outputs are missing."""
    N, n = m.shape
    ny = y.shape[1]
    y_hat = np.empty(ny)
    both = np.empty((2, ny, n))
    seen = np.empty(ny, dtype=np.bool_)
    block = np.empty(ny, dtype=np.int64)
    W, w = np.empty((ny, ny)), np.empty(ny)
    E, spread, residual = np.empty((n + 1 + ny, ny)), np.empty((ny, ny)), np.empty((1, ny))
    # Whether spread is that of the sample before, whose outputs were all measured.
    known = False
    for k in range(N):
        H, H_before = both[k % 2], both[1 - k % 2]
        if linearisation == FILTERED:
            copy_matrix(H_pred[k], H)
            for i in range(ny):
                y_hat[i] = y[k, i] - innovation[k, i]
                for j in range(n):
                    y_hat[i] += H[i, j] * (m[k, j] - m_pred[k, j])
        else:
            output_jacobian(m[k], u[k], p, y_hat, H)
        count = 0
        for i in range(ny):
            seen[i] = not math.isnan(y[k, i])
            count += 1 if seen[i] else 0
            residual[0, i] = y[k, i] - y_hat[i] if seen[i] else 0.0
        if count == ny:
            if not (known and same(H, H_before) and same(U[k], U[k - 1])):
                rows_of(U[k], H, 0, ny, E, 0, 0)
                spread[:] = 0.0
                add_products(E, n, spread)
            sum_e += spread
            add_products(residual, 1, sum_e)
            samples += 1.0
        elif count > 0:
            rows_of(U[k], H, 0, ny, E, 0, 0)
            for i in range(ny):
                if not seen[i]:
                    E[:n, i] = 0.0
            copy(residual[0], E[n])
            add_sample(E, n + 1, seen, UR, block_of, block, sum_e, samples, W, w)
        known = count == ny

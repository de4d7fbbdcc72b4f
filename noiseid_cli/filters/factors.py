"""Rank-one changes of an upper factor U, P = U'U, and the derivative of U from that of P."""

from __future__ import annotations

import math

import numpy as np

from noiseid_cli.models.jit import routine


@routine
def update(U, m, v):  # type: ignore[no-untyped-def]
    """U'U + v v', by m plane rotations (Golub & Van Loan, Matrix Computations, 6.5).

    Args:
        U: upper factor with non-negative diagonal, of which U[:m, :m] is overwritten.
        m: its size.
        v: (>= m,), overwritten.
    """
    for k in range(m):
        if v[k] == 0.0:
            continue
        r = math.sqrt(U[k, k] * U[k, k] + v[k] * v[k])
        c, s = U[k, k] / r, v[k] / r
        U[k, k] = r
        for j in range(k + 1, m):
            t = U[k, j]
            U[k, j] = c * t + s * v[j]
            v[j] = c * v[j] - s * t


@routine
def downdate(U, m, v, least, c):  # type: ignore[no-untyped-def]
    """U'U - v v', as LINPACK's dchdd does it: U^-T v first, then rotations from the bottom up.

    Args:
        U, m: as in ``update``.
        v: (>= m,), overwritten.
        least: share det(U'U - v v') / det(U'U) that must be left, above 0 or 0; rounding is amplified by its inverse.
        c: scratch (>= m,).

    Returns:
        Whether more than that is left; if not, U stays as it is.
    """
    left = 1.0
    for i in range(m):
        for k in range(i):
            v[i] -= U[k, i] * v[k]
        if v[i] != 0.0:
            v[i] /= U[i, i]
        left -= v[i] * v[i]
    if not left > least:
        return False
    alpha = math.sqrt(left)
    for i in range(m - 1, -1, -1):
        r = math.sqrt(alpha * alpha + v[i] * v[i])
        c[i] = alpha / r
        v[i] /= r
        alpha = r
    for j in range(m):
        carried = 0.0
        for i in range(j, -1, -1):
            t = c[i] * carried + v[i] * U[i, j]
            U[i, j] = c[i] * U[i, j] - v[i] * carried
            carried = t
    return True


@routine
def take_away(U, B, q, least, c, v):  # type: ignore[no-untyped-def]
    """U'(I - BB')U: q downdates by the columns of U'B, for which B is known and nothing has to be solved.

    The rotations of a downdate [U; 0] -> [U_new; b'U] turn the columns still to come as well: with a last entry of
    -b'b_j / sqrt(1 - b'b), which the rotations make zero, b_j becomes that of U_new.

    Args:
        U: (n, n) upper factor with non-negative diagonal, overwritten.
        B: (n, >= q), overwritten.
        q: number of columns.
        least: as in ``downdate``, of each column.
        c, v: scratch (>= n,).

    Returns:
        Whether more than that is left each time; if not, U has lost the columns before.
    """
    n, q, one = np.uint64(U.shape[0]), np.uint64(q), np.uint64(1)
    for b in range(q):
        total = 0.0
        for r in range(n):
            total += B[r, b] * B[r, b]
        left = 1.0 - total
        if not left > least:
            return False
        alpha = math.sqrt(left)
        for j in range(b + one, q):
            carried = 0.0
            for r in range(n):
                carried -= B[r, b] * B[r, j]
            v[j] = carried / alpha
        # All lengths first: their roots do not wait for each other.
        total = left
        for back in range(n):
            i = n - one - back
            total += B[i, b] * B[i, b]
            c[i] = math.sqrt(total)
        for back in range(n):
            i = n - one - back
            scale = 1.0 / c[i]
            cosine, sine = scale * alpha, scale * B[i, b]
            alpha = c[i]
            c[i], B[i, b] = cosine, sine
            for j in range(b + one, q):
                carried, t = v[j], B[i, j]
                v[j] = cosine * carried + sine * t
                B[i, j] = cosine * t - sine * carried
        for j in range(n):
            v[j] = 0.0
        for back in range(n):
            i = n - one - back
            cosine, sine = c[i], B[i, b]
            for j in range(i, n):
                carried, t = v[j], U[i, j]
                v[j] = cosine * carried + sine * t
                U[i, j] = cosine * t - sine * carried
    return True


@routine
def weighted_rank_one(U, m, v, weight, c):  # type: ignore[no-untyped-def]
    """U'U + weight v v'; returns False, with U as it was, if a negative weight leaves nothing positive definite."""
    size = math.sqrt(abs(weight))
    for i in range(m):
        v[i] *= size
    if weight < 0.0:
        return downdate(U, m, v, 0.0, c)
    update(U, m, v)
    return True


@routine
def factor_derivative(U, dP, dU, A):  # type: ignore[no-untyped-def]
    """Derivative of the upper factor with positive diagonal: dU = Phi(U^-T dP U^-1) U.

    Phi takes the upper triangle with its diagonal halved. By triangular solves, in O(n^3); riva2017_sensitivity_asrukf
    (Table 1) solves the same linear system with Kronecker products and an elimination matrix, in O(n^6).

    Args:
        U: (n, n) factor; dP: (n, n) symmetric derivative of P = U'U.
        dU: (n, n), written.
        A: scratch (n, n).
    """
    n, one = np.uint64(U.shape[0]), np.uint64(1)
    # Both solves keep to the upper half, U^-T dP U^-1 being symmetric; 1 / U[r, r] waits in a row that is written last.
    scale = dU[0]
    for r in range(n):
        scale[r] = 1.0 / U[r, r]
        for c in range(r, n):
            total = dP[r, c]
            for k in range(r):
                total -= U[k, r] * A[k, c]
            A[r, c] = scale[r] * total
    for r in range(n):
        for c in range(r, n):
            total = A[r, c]
            for k in range(r):
                total -= A[k, r] * U[k, c]
            for k in range(r, c):
                total -= A[r, k] * U[k, c]
            A[r, c] = scale[c] * total
    for r in range(n):
        for c in range(n):
            total = 0.0
            if r <= c:
                total = 0.5 * A[r, r] * U[r, c]
                for k in range(r + one, c + one):
                    total += A[r, k] * U[k, c]
            dU[r, c] = total

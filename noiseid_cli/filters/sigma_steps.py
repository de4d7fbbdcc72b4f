"""The steps that square-root sigma-point filters share: spread of points, conditioning on an output.

Additive noise, riva2017_sensitivity_asrukf (Tables 1 and 2) and van der Merwe & Wan (2001), with upper factors
P = U'U: the transposes of the papers' S.
"""

from __future__ import annotations

import math

import numpy as np

from noiseid_cli.filters.ekf import NOT_FINITE, OK, SINGULAR_INNOVATION
from noiseid_cli.filters.ekf_steps import LOG_2PI
from noiseid_cli.filters.factors import take_away, weighted_rank_one
from noiseid_cli.filters.gram_schmidt import upper_of_columns
from noiseid_cli.filters.linalg import EPS
from noiseid_cli.models.arrays import copy, copy_matrix
from noiseid_cli.models.jit import routine

LEAST = math.sqrt(EPS)
INDEFINITE_PREDICTION, INDEFINITE_INNOVATION, INDEFINITE_CORRECTION, SINGULAR_STATE = 3, 4, 5, 6


@routine
def spread(Y, m, mean, outer, cov0, noise, A, w, d, U):  # type: ignore[no-untyped-def]
    """Factor of the covariance of weighted points plus noise.

    U'U = outer sum_i (Y_i - mean)(Y_i - mean)' + cov0 (Y_0 - mean)(Y_0 - mean)' + noise' noise: the factor of a stack.
    A negative weight of the central point is a downdate after it.

    Args:
        Y: (1 + rows, >= m) points; the first m columns are read.
        mean: (>= m,); noise: (k, >= m) rows.
        A, w, d: scratch (>= m, >= width(1 + rows + k)), (>= m,), (>= m,).
        U: (>= m, >= m), written: upper, non-negative diagonal, zeros below.

    Returns:
        Whether the covariance is positive definite after the change for the central point.
    """
    # Of unsigned indices numba knows that they do not count from the end, see ``linalg.reflect``.
    columns, one, rows, k = np.uint64(m), np.uint64(1), np.uint64(Y.shape[0] - 1), np.uint64(noise.shape[0])
    size, central = math.sqrt(outer), math.sqrt(max(cov0, 0.0))
    for c in range(columns):
        for r in range(rows):
            A[c, r] = size * (Y[one + r, c] - mean[c])
        for r in range(k):
            A[c, rows + r] = noise[r, c]
        d[c] = Y[0, c] - mean[c]
        A[c, rows + k] = central * d[c]
    upper_of_columns(A, m, rows + k + one, U)
    return cov0 >= 0.0 or weighted_rank_one(U, m, d, cov0, w)


@routine
def keep_observed(y, Y, UR, observed, UR_seen):  # type: ignore[no-untyped-def]
    """Move the columns of observed outputs to the front of Y, and of the noise factor's copy.

    Args:
        y: (ny,), NaN where missing; Y: (points, ny), overwritten; UR: (ny, ny).
        observed: (ny,) int, written: index of each observed output.
        UR_seen: (ny, ny), written.

    Returns:
        Number of observed outputs.
    """
    q = 0
    for i in range(y.shape[0]):
        if math.isnan(y[i]):
            continue
        observed[q] = i
        for r in range(Y.shape[0] if q < i else 0):
            Y[r, q] = Y[r, i]
        for r in range(UR.shape[0]):
            UR_seen[r, q] = UR[r, i]
        q += 1
    return q


@routine
def condition(x, U, Y, q, y_hat, e, UR, eta, outer, cov0, x_new, U_new, Uyy, B, K, A, w, d):  # type: ignore[no-untyped-def]
    """Condition (x, P = U'U) on q outputs whose sigma points are Y.

    With D the differences of the output points in pairs and B = eta outer D Uyy^-1, which is (n, q): Pxy = eta outer
    U'D, K Uyy' = U'B, K = U'B Uyy^-T, x + K e, and U'(I - BB')U by q downdates. One that leaves less than ``LEAST`` of
    the determinant fails: it would lose more than half of the digits. The same covariance is then stacked from the
    residuals (X_i - x) - K (Y_i - y^) and K R K', which subtracts only what the weight of the central point subtracts.

    Args:
        x, U: predicted mean (n,) and factor (n, n), from which the points were drawn.
        Y: (2n + 1, >= q) output points, observed columns first; y_hat: (>= q,) their mean.
        e: (>= q,) innovation y - y_hat; UR: (ny, >= q) observed columns of the factor of R.
        eta, outer, cov0: see ``sigma_points``.
        x_new, U_new: (n,), (n, n), written.
        Uyy: (ny, ny), K: (n, ny), written in the first q rows and columns; B: scratch (n, ny).
        A, w, d: scratch (max(n, ny), width(2n + ny + 1)), (max(n, ny),), (max(n, ny),).

    Returns:
        (code, log-likelihood of e, whether the downdates failed).
    """
    copy(x, x_new)
    copy_matrix(U, U_new)
    if q == 0:
        return OK, 0.0, False
    if not spread(Y, q, y_hat, outer, cov0, UR, A, w, d, Uyy):
        return INDEFINITE_INNOVATION, math.nan, False
    loglik = -0.5 * q * LOG_2PI
    for b in range(q):
        if not math.isfinite(Uyy[b, b]) or not math.isfinite(e[b]):
            return NOT_FINITE, math.nan, False
        if Uyy[b, b] == 0.0:
            return SINGULAR_INNOVATION, math.nan, False
    loglik += _gain(U, Y, q, e, eta * outer, x_new, Uyy, B, K, w, d)
    failed = not take_away(U_new, B, q, LEAST, w, d)
    if failed and not _stack(U, Y, q, y_hat, UR, eta, outer, cov0, U_new, K, A, w, d):
        return INDEFINITE_CORRECTION, math.nan, True
    return OK, loglik, failed


@routine
def _gain(U, Y, q, e, scale, x_new, Uyy, B, K, w, d):  # type: ignore[no-untyped-def]
    """B and K of ``condition``; adds K e to x_new. Returns the log-likelihood of e without the term of 2 pi."""
    n, q, one = np.uint64(U.shape[0]), np.uint64(q), np.uint64(1)
    loglik = 0.0
    for b in range(q):
        w[b] = 1.0 / Uyy[b, b]
        d[b] = e[b]
        for c in range(b):
            d[b] -= Uyy[c, b] * d[c]
        d[b] *= w[b]
        loglik -= 0.5 * d[b] * d[b] + math.log(Uyy[b, b])
    for r in range(n):
        for b in range(q):
            total = scale * (Y[one + r, b] - Y[one + n + r, b])
            for c in range(b):
                total -= Uyy[c, b] * B[r, c]
            B[r, b] = total * w[b]
    # K holds U'B = K Uyy' first.
    for a in range(n):
        for b in range(q):
            total = 0.0
            for r in range(a + one):
                total += U[r, a] * B[r, b]
            K[a, b] = total
            x_new[a] += total * d[b]
        for back in range(q):
            b = q - one - back
            for c in range(b + one, q):
                K[a, b] -= Uyy[b, c] * K[a, c]
            K[a, b] *= w[b]
    return loglik


@routine
def _stack(U, Y, q, y_hat, UR, eta, outer, cov0, U_new, K, A, w, d):  # type: ignore[no-untyped-def]
    """The corrected factor from the residuals of the points; see ``condition``."""
    n, ny = U.shape[0], UR.shape[0]
    size = math.sqrt(outer)
    for a in range(n):
        for r in range(n):
            step = eta * U[r, a] if r <= a else 0.0
            plus, minus = step, -step
            for b in range(q):
                plus -= K[a, b] * (Y[1 + r, b] - y_hat[b])
                minus -= K[a, b] * (Y[1 + n + r, b] - y_hat[b])
            A[a, r], A[a, n + r] = size * plus, size * minus
        for r in range(ny):
            A[a, 2 * n + r] = 0.0
            for b in range(q):
                A[a, 2 * n + r] += UR[r, b] * K[a, b]
        d[a] = 0.0
        for b in range(q):
            d[a] -= K[a, b] * (Y[0, b] - y_hat[b])
    upper_of_columns(A, n, 2 * n + ny, U_new)
    return weighted_rank_one(U_new, n, d, cov0, w)

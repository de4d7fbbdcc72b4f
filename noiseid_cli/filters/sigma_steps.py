"""The steps that square-root sigma-point filters share: spread of points, conditioning on an output.

Additive noise, riva2017_sensitivity_asrukf (Tables 1 and 2) and van der Merwe & Wan (2001), with upper factors
P = U'U: the transposes of the papers' S.
"""

from __future__ import annotations

import math

from noiseid_cli.filters.ekf import NOT_FINITE, OK, SINGULAR_INNOVATION
from noiseid_cli.filters.ekf_steps import LOG_2PI
from noiseid_cli.filters.factors import downdate, weighted_rank_one
from noiseid_cli.filters.linalg import EPS, backward_solve, forward_solve, triangularise
from noiseid_cli.models.arrays import copy, copy_matrix
from noiseid_cli.models.jit import routine

LEAST = math.sqrt(EPS)
INDEFINITE_PREDICTION, INDEFINITE_INNOVATION, INDEFINITE_CORRECTION, SINGULAR_STATE = 3, 4, 5, 6


@routine
def spread(Y, m, mean, outer, cov0, noise, W, w, d, U):  # type: ignore[no-untyped-def]
    """Factor of the covariance of weighted points plus noise.

    U'U = outer sum_i (Y_i - mean)(Y_i - mean)' + cov0 (Y_0 - mean)(Y_0 - mean)' + noise' noise: one triangularisation,
    then a rank-one change for the central point, whose weight may be negative.

    Args:
        Y: (1 + rows, >= m) points; the first m columns are read.
        mean: (>= m,); noise: (k, >= m) rows.
        W, w, d: scratch (>= rows + k, >= m), (>= m,), (>= m,).
        U: (>= m, >= m), written: upper, non-negative diagonal, zeros below.

    Returns:
        Whether the covariance is positive definite after the change for the central point.
    """
    rows, k = Y.shape[0] - 1, noise.shape[0]
    size = math.sqrt(outer)
    for c in range(m):
        for r in range(rows):
            W[r, c] = size * (Y[1 + r, c] - mean[c])
        for r in range(k):
            W[rows + r, c] = noise[r, c]
    triangularise(W, rows + k, m, m, w)
    for r in range(m):
        for c in range(m):
            U[r, c] = W[r, c] if r < rows + k and r <= c else 0.0
        d[r] = Y[0, r] - mean[r]
    return weighted_rank_one(U, m, d, cov0, w)


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
        for r in range(Y.shape[0]):
            Y[r, q] = Y[r, i]
        for r in range(UR.shape[0]):
            UR_seen[r, q] = UR[r, i]
        q += 1
    return q


@routine
def condition(x, U, Y, q, y_hat, e, UR, eta, outer, cov0, x_new, U_new, Uyy, Pxy, K, W, w, d):  # type: ignore[no-untyped-def]
    """Condition (x, P = U'U) on q outputs whose sigma points are Y.

    Pxy by the points' own directions U, K = Pxy Uyy^-1 Uyy^-T, x + K e, and q downdates of U with the columns of
    K Uyy'. A downdate that leaves less than ``LEAST`` of the determinant fails: it would lose more than half of the
    digits. The same covariance is then stacked from the residuals (X_i - x) - K (Y_i - y^) and K R K', which subtracts
    only what the weight of the central point subtracts.

    Args:
        x, U: predicted mean (n,) and factor (n, n), from which the points were drawn.
        Y: (2n + 1, >= q) output points, observed columns first; y_hat: (>= q,) their mean.
        e: (>= q,) innovation y - y_hat; UR: (ny, >= q) observed columns of the factor of R.
        eta, outer, cov0: see ``sigma_points``.
        x_new, U_new: (n,), (n, n), written.
        Uyy: (ny, ny), Pxy: (n, ny), K: (n, ny), written in the first q rows and columns.
        W, w, d: scratch (2n + ny, max(n, ny)), (max(n, ny),), (max(n, ny),).

    Returns:
        (code, log-likelihood of e, whether the downdates failed).
    """
    n = x.shape[0]
    copy(x, x_new)
    copy_matrix(U, U_new)
    if q == 0:
        return OK, 0.0, False
    if not spread(Y, q, y_hat, outer, cov0, UR, W, w, d, Uyy):
        return INDEFINITE_INNOVATION, math.nan, False
    loglik = -0.5 * q * LOG_2PI
    for b in range(q):
        if not math.isfinite(Uyy[b, b]) or not math.isfinite(e[b]):
            return NOT_FINITE, math.nan, False
        if Uyy[b, b] == 0.0:
            return SINGULAR_INNOVATION, math.nan, False
        d[b] = e[b]
    forward_solve(Uyy, q, d)
    for b in range(q):
        loglik -= 0.5 * d[b] * d[b] + math.log(Uyy[b, b])
    for a in range(n):
        for b in range(q):
            total = 0.0
            for r in range(a + 1):
                total += U[r, a] * (Y[1 + r, b] - Y[1 + n + r, b])
            Pxy[a, b] = eta * outer * total
    # K holds V = Pxy Uyy^-1 = K Uyy' first.
    for a in range(n):
        for b in range(q):
            K[a, b] = Pxy[a, b]
        forward_solve(Uyy, q, K[a])
        for b in range(q):
            x_new[a] += K[a, b] * d[b]
    failed = False
    for b in range(q):
        for a in range(n):
            d[a] = K[a, b]
        if not downdate(U_new, n, d, LEAST, w):
            failed = True
            break
    for a in range(n):
        backward_solve(Uyy, q, K[a])
    if failed and not _stack(U, Y, q, y_hat, UR, eta, outer, cov0, U_new, K, W, w, d):
        return INDEFINITE_CORRECTION, math.nan, True
    return OK, loglik, failed


@routine
def _stack(U, Y, q, y_hat, UR, eta, outer, cov0, U_new, K, W, w, d):  # type: ignore[no-untyped-def]
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
            W[r, a], W[n + r, a] = size * plus, size * minus
        for r in range(ny):
            W[2 * n + r, a] = 0.0
            for b in range(q):
                W[2 * n + r, a] += UR[r, b] * K[a, b]
        d[a] = 0.0
        for b in range(q):
            d[a] -= K[a, b] * (Y[0, b] - y_hat[b])
    triangularise(W, 2 * n + ny, n, n, w)
    for r in range(n):
        for c in range(n):
            U_new[r, c] = W[r, c] if r <= c else 0.0
    return weighted_rank_one(U_new, n, d, cov0, w)

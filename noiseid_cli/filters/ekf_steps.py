"""One step of the extended Kalman filter in square-root array form.

Each update and each prediction is one orthogonal triangularisation (Kailath, Sayed & Hassibi, Linear Estimation,
ch. 12); factors are upper triangles U with P = U'U, see ``filters.linalg``.
"""

from __future__ import annotations

import math

import numpy as np

from noiseid_cli.filters.linalg import echelon, rows_of, triangularise
from noiseid_cli.models.jit import routine

LOG_2PI = math.log(2.0 * math.pi)


@routine
def update(m, U, H, innovation, UR, m_out, U_out, W, w, e):  # type: ignore[no-untyped-def]
    """Measurement update: [UR 0; U H', U] over the observed outputs becomes [US, US^-T H P; 0, U_filt], S = US'US.

    Rotations from the last row of U to the first keep it triangular, which leaves them a third of the work that
    reflections have (Carlson, AIAA Journal 11(9), 1973, for one output at a time; here each carries the outputs that
    are still to come, so that R need not be diagonal).

    Args:
        m, U: predicted mean (n,) and factor (n, n).
        H: (ny, n); innovation: (ny,), NaN where missing; UR: (ny, ny) factor of R.
        m_out, U_out: outputs, may not alias U.
        W, w, e: scratch (ny + n, ny + n), (ny + n,), (ny,). W's first rows come out as [US, US^-T H P].

    Returns:
        The log-likelihood of the innovation, NaN if S is singular.
    """
    ny, n = H.shape
    q = 0
    for i in range(ny):
        if math.isnan(innovation[i]):
            continue
        for r in range(ny):
            W[r, q] = UR[r, i]
        rows_of(U, H, i, 1, W, ny, q)
        e[q] = innovation[i]
        q += 1
    if q < ny:
        triangularise(W, ny, q, q, w)
    for c in range(n):
        for r in range(q):
            W[r, q + c] = 0.0
        for r in range(n):
            U_out[r, c] = U[r, c] if r <= c else 0.0
    for i in range(q):
        _take_in(W, i, q, ny, U_out, w)
    return correct(W, q, m, e, m_out)


@routine
def _take_in(W, i, q, ny, U, length):  # type: ignore[no-untyped-def]
    """Rotate column i of U H', in W from row ny on, into row i of W, from the last row of U to the first.

    Args:
        W: rows 0..q of [UR, gains] and, from row ny on, U H'.
        i, q, ny: the output, and the numbers of those observed and of all.
        U: (n, n), upper before and after.
        length: scratch (>= n,).
    """
    n, i, q, ny = np.uint64(U.shape[0]), np.uint64(i), np.uint64(q), np.uint64(ny)
    one = np.uint64(1)
    # All lengths of the pivot first: their roots do not wait for each other.
    total = W[i, i] * W[i, i]
    for back in range(n):
        r = n - one - back
        total += W[ny + r, i] * W[ny + r, i]
        length[r] = math.sqrt(total)
    pivot = W[i, i]
    for back in range(n):
        r = n - one - back
        if W[ny + r, i] == 0.0 or length[r] == 0.0:
            continue
        scale = 1.0 / length[r]
        cosine, sine = scale * pivot, scale * W[ny + r, i]
        pivot = length[r]
        for c in range(r, n):
            above, below = W[i, q + c], U[r, c]
            W[i, q + c] = cosine * above + sine * below
            U[r, c] = cosine * below - sine * above
        for c in range(i + one, q):
            above, below = W[i, c], W[ny + r, c]
            W[i, c] = cosine * above + sine * below
            W[ny + r, c] = cosine * below - sine * above
    W[i, i] = pivot


@routine
def condition(W, rows, q, m, e, m_out, U_out, w):  # type: ignore[no-untyped-def]
    """Mean and factor of x given y from rows of the joint factor of (y, x), by one triangularisation.

    Args:
        W: (>= rows, >= q + n), factor rows of the q observed outputs and of the state; overwritten.
        rows, q: the part of W in use.
        m: (n,) predicted mean; e: (>= q,) innovations, overwritten by the whitened ones.
        m_out, U_out: outputs (n,), (n, n).
        w: scratch (>= q + n,).

    Returns:
        The log-likelihood of the innovations, NaN if their covariance is singular.
    """
    n = m.shape[0]
    triangularise(W, rows, q + n, q + n, w)
    for r in range(n):
        for c in range(n):
            U_out[r, c] = W[q + r, q + c] if r <= c else 0.0
    return correct(W, q, m, e, m_out)


@routine
def correct(W, q, m, e, m_out):  # type: ignore[no-untyped-def]
    """Mean of x given y from the triangularised joint factor of (y, x), see ``condition``, which it is a part of."""
    n = m.shape[0]
    loglik = -0.5 * q * LOG_2PI
    for i in range(q):
        for j in range(i):
            e[i] -= W[j, i] * e[j]
        if W[i, i] == 0.0:
            return math.nan
        e[i] /= W[i, i]
        loglik -= 0.5 * e[i] * e[i] + math.log(W[i, i])
    for c in range(n):
        m_out[c] = m[c]
        for i in range(q):
            m_out[c] += W[i, q + c] * e[i]
    return loglik


@routine
def predict(U, F, G, UQ, U_out, W, w):  # type: ignore[no-untyped-def]
    """Time update of the factor: U_out from one triangularisation of [U F'; UQ G'].

    Args:
        U: (n, n) filtered factor; F: (n, n); G: (n, nv); UQ: (nv, nv) factor of Q.
        U_out: (n, n) predicted factor.
        W, w: scratch (n + nv, n), (n,).
    """
    n, nv = G.shape
    rows_of(U, F, 0, n, W, 0, 0)
    rows_of(UQ, G, 0, n, W, n, 0)
    triangularise(W, n + nv, n, n, w)
    for r in range(n):
        for c in range(n):
            U_out[r, c] = W[r, c]


@routine
def predict_joint(U, F, G, UQ, U_out, gain, C, W, pivot_column, w):  # type: ignore[no-untyped-def]
    """Time update of the factor with what the smoother needs of the step, by one triangularisation.

    The joint of (x_{k+1}, x_k, v_k) given y_1..y_k,

        [U F'   U  0 ]      [U_out  R12]
        [UQ G'  0  UQ]  ->  [0      C  ],

    gives the gain X' = U_out^-1 R12 of (x_k, v_k) on x_{k+1} and
    the factor C of Cov(x_k, v_k | x_{k+1}, y_1..y_k). Where the predicted covariance is singular, the gain has no
    component along directions that the others determine.

    Args:
        U, F, G, UQ, U_out: as in ``predict``.
        gain: (n + nv, n), written; C: (rows, n + nv), written.
        W, pivot_column, w: scratch (n + nv, 2 n + nv), (n,), (2 n + nv,).

    Returns:
        The rank of the predicted covariance.
    """
    n, nv = G.shape
    rows_of(U, F, 0, n, W, 0, 0)
    rows_of(UQ, G, 0, n, W, n, 0)
    for r in range(n):
        for c in range(n):
            W[r, n + c] = U[r, c] if r <= c else 0.0
        for c in range(nv):
            W[r, 2 * n + c] = 0.0
    for r in range(nv):
        for c in range(n):
            W[n + r, n + c] = 0.0
        for c in range(nv):
            W[n + r, 2 * n + c] = UQ[r, c]
    rank = echelon(W, n + nv, 2 * n + nv, n, pivot_column, w)
    for r in range(n):
        for c in range(n):
            U_out[r, c] = W[r, c] if r < rank else 0.0
    for r in range(C.shape[0]):
        for c in range(n + nv):
            C[r, c] = W[rank + r, n + c] if rank + r < n + nv else 0.0
    # Back-substitution over the pivot columns: gain' = W[:, :n]^-1 W[:, n:].
    gain[:] = 0.0
    one, end = np.uint64(1), np.uint64(rank)
    for back in range(rank):
        i = np.uint64(rank - 1 - back)
        pivot = np.uint64(pivot_column[i])
        scale = 1.0 / W[i, pivot]
        for j in range(np.uint64(n + nv)):
            total = W[i, np.uint64(n) + j]
            for c in range(i + one, end):
                other = np.uint64(pivot_column[c])
                total -= W[i, other] * gain[j, other]
            gain[j, pivot] = scale * total
    return rank

"""One step of the extended Kalman filter in square-root array form.

Each update and each prediction is one orthogonal triangularisation (Kailath, Sayed & Hassibi, Linear Estimation,
ch. 12); factors are upper triangles U with P = U'U, see ``filters.linalg``.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from noiseid_cli.filters.linalg import back_substitute, echelon, transpose, triangularise, upper_times
from noiseid_cli.models.jit import allocating, routine
from noiseid_cli.models.vectors import EIGHT, blocks, clear, load, plus, rows_out, store, times

LOG_2PI = math.log(2.0 * math.pi)


class Scratch(NamedTuple):
    """Matrices that the steps of one filter work in; rows are as long as their blocks of eight."""

    Ht: Any  # H', columns of the observed outputs only
    Ft: Any  # F'
    Gt: Any  # G'
    W: Any  # (ny + n, ...), the joint of the outputs and x_k
    T: Any  # (n + nv, ...), the joint of x_{k+1} and, for a smoother, (x_k, v_k)
    e: Any  # (ny,) innovations of the observed outputs, whitened by the update
    cosine: Any  # (n,)
    sine: Any  # (n,)
    pivot_column: Any  # (n,)


@allocating
def scratch(n, nv, ny, joint):  # type: ignore[no-untyped-def]
    """Make the scratch matrices; ``joint`` says whether for a smoother."""
    columns = max(blocks(2 * n + nv), n + blocks(n + nv)) if joint else blocks(n)
    return Scratch(
        np.zeros((n, blocks(ny))), np.zeros((n, blocks(n))), np.zeros((nv, blocks(n))),
        np.zeros((ny + n, blocks(ny + blocks(n)))), np.zeros((n + nv, columns)),
        np.zeros(ny), np.zeros(n), np.zeros(n), np.zeros(n, dtype=np.int64),
    )  # fmt: skip


@routine
def update(m, U, H, innovation, UR, m_out, U_out, s):  # type: ignore[no-untyped-def]
    """Measurement update: [UR 0; U H', U] over the observed outputs becomes [US, US^-T H P; 0, U_filt], S = US'US.

    Rotations from the last row of U to the first keep it triangular, which leaves them a third of the work that
    reflections have (Carlson, AIAA Journal 11(9), 1973, for one output at a time; here each carries the outputs that
    are still to come, so that R need not be diagonal).

    Args:
        m, U: predicted mean (n,) and factor (n, n).
        H: (ny, n); innovation: (ny,), NaN where missing; UR: (ny, ny) factor of R.
        m_out, U_out: outputs.
        s: ``Scratch``. W's first rows come out as [US, US^-T H P], e as the whitened innovations.

    Returns:
        The log-likelihood of the innovation, NaN if S is singular, infinite if numbers are not finite.
    """
    ny, n = H.shape
    W = s.W
    q = 0
    for i in range(ny):
        if math.isnan(innovation[i]):
            continue
        for r in range(ny):
            W[r, q] = UR[r, i]
        for c in range(n):
            s.Ht[c, q] = H[i, c]
        s.e[q] = innovation[i]
        q += 1
    if q < ny:
        triangularise(W, ny, q, q)
    upper_times(U, s.Ht, W, ny)
    for r in range(q):
        clear(W, r, q)
    for r in range(n):
        for c in range(n):
            W[ny + r, q + c] = U[r, c]
    for i in range(q):
        _take_in(W, i, ny, s.cosine, s.sine)
    rows_out(W, ny, q, U_out)
    return correct(W, q, m, s.e, m_out)


@routine
def _take_in(W, i, ny, cosine, sine):  # type: ignore[no-untyped-def]
    """Rotate column i of W's rows from ny on into its row i, from the last row to the first.

    Args:
        W: rows 0..ny of the outputs' factor and gains; from row ny on [U H', U], whose second part stays upper.
        i, ny: the output, and the number of all.
        cosine, sine: scratch (n,).
    """
    n, i, ny = np.uint64(cosine.shape[0]), np.uint64(i), np.uint64(ny)
    one = np.uint64(1)
    # All angles first: their roots and quotients do not wait for each other.
    pivot = W[i, i]
    total = pivot * pivot
    for back in range(n):
        r = n - one - back
        below = W[ny + r, i]
        total += below * below
        cosine[r], sine[r] = 1.0, 0.0
        if below != 0.0 and total != 0.0:
            length = math.sqrt(total)
            scale = 1.0 / length
            cosine[r], sine[r] = scale * pivot, scale * below
            pivot = length
    for block in range(i // EIGHT, np.uint64(W.shape[1]) // EIGHT):
        c = block * EIGHT
        above = load(W, i, c)
        for back in range(n):
            r = n - one - back
            below = load(W, ny + r, c)
            store(W, ny + r, c, plus(times(cosine[r], below), -sine[r], above))
            above = plus(times(cosine[r], above), sine[r], below)
        store(W, i, c, above)
    W[i, i] = pivot


@routine
def condition(W, rows, q, m, e, m_out, U_out):  # type: ignore[no-untyped-def]
    """Mean and factor of x given y from rows of the joint factor of (y, x), by one triangularisation.

    Args:
        W: (>= rows, >= q + n), factor rows of the q observed outputs and of the state; overwritten.
        rows, q: the part of W in use.
        m: (n,) predicted mean; e: (>= q,) innovations, overwritten by the whitened ones.
        m_out, U_out: outputs (n,), (n, n).

    Returns:
        As ``update``.
    """
    n = m.shape[0]
    triangularise(W, rows, q + n, q + n)
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
    return math.inf if math.isnan(loglik) else loglik


@routine
def predict(U, F, G, UQ, U_out, s):  # type: ignore[no-untyped-def]
    """Time update of the factor: U_out from one triangularisation of [U F'; UQ G'].

    Args:
        U: (n, n) filtered factor; F: (n, n); G: (n, nv); UQ: (nv, nv) factor of Q.
        U_out: (n, n) predicted factor.
        s: ``Scratch``.
    """
    n, nv = G.shape
    _propagate(U, F, G, UQ, s)
    triangularise(s.T, n + nv, s.Ft.shape[1], n)
    rows_out(s.T, 0, 0, U_out)


@routine
def _propagate(U, F, G, UQ, s):  # type: ignore[no-untyped-def]
    """Write [U F'; UQ G'] to the first columns of T."""
    transpose(F, s.Ft)
    transpose(G, s.Gt)
    upper_times(U, s.Ft, s.T, 0)
    upper_times(UQ, s.Gt, s.T, G.shape[0])


@routine
def predict_joint(U, F, G, UQ, U_out, gain_t, C, s):  # type: ignore[no-untyped-def]
    """Time update of the factor with what the smoother needs of the step, by one triangularisation.

    The joint of (x_{k+1}, x_k, v_k) given y_1..y_k,

        [U F'   U  0 ]      [U_out  R12]
        [UQ G'  0  UQ]  ->  [0      C  ],

    gives the gain X' = U_out^-1 R12 of (x_k, v_k) on x_{k+1} and
    the factor C of Cov(x_k, v_k | x_{k+1}, y_1..y_k). Where the predicted covariance is singular, the gain has no
    component along directions that the others determine.

    Args:
        U, F, G, UQ, U_out: as in ``predict``.
        gain_t: X' (n, n + nv), written; C: (rows, n + nv), written.
        s: ``Scratch`` for a smoother.

    Returns:
        The rank of the predicted covariance.
    """
    n, nv = G.shape
    T, pivot_column = s.T, s.pivot_column
    _propagate(U, F, G, UQ, s)
    for r in range(n):
        for c in range(n):
            T[r, n + c] = U[r, c]
        clear(T, r, 2 * n)
    for r in range(nv):
        clear(T, n + r, n)
        for c in range(r, nv):
            T[n + r, 2 * n + c] = UQ[r, c]
    rank = echelon(T, n + nv, blocks(2 * n + nv), n, pivot_column)
    if rank == n and C.shape[0] == nv:
        rows_out(T, 0, 0, U_out)
        rows_out(T, n, n, C)
        back_substitute(T, n, pivot_column, n, 2 * n + nv)
        rows_out(T, 0, n, gain_t)
        return n
    for r in range(n):
        for c in range(n):
            U_out[r, c] = T[r, c] if r < rank else 0.0
    for r in range(C.shape[0]):
        for c in range(n + nv):
            C[r, c] = T[rank + r, n + c] if rank + r < n + nv else 0.0
    back_substitute(T, rank, pivot_column, n, 2 * n + nv)
    for r in range(n):
        for c in range(n + nv):
            gain_t[r, c] = 0.0
    for i in range(rank):
        for c in range(n + nv):
            gain_t[pivot_column[i], c] = T[i, n + c]
    return rank

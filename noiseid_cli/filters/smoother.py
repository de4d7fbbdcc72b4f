"""The extended Kalman (Rauch-Tung-Striebel) smoother in square-root array form.

Backward from the filter's results. One triangularisation of the joint of (x_{k+1}, x_k, v_k) given y_1..y_k,

    [U F'   U  0 ]      [U_pred  R12]
    [UQ G'  0  UQ]  ->  [0       C  ],

gives the gain X' = U_pred^-1 R12 of (x_k, v_k) on x_{k+1} and the factor C of Cov(x_k, v_k | x_{k+1}, y_1..y_k).
Nothing is subtracted and no covariance is inverted (Park & Kailath 1995, square-root RTS; with the noise as a further
row it is the disturbance smoother as well).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import types

from noiseid_cli.filters.ekf import Filtered, cube
from noiseid_cli.filters.linalg import echelon, rows_of, triangularise, upper_factor
from noiseid_cli.filters.rest import at_rest, copy, same
from noiseid_cli.models.jit import kernel, routine
from noiseid_cli.models.recording import Array
from noiseid_cli.models.signatures import matrix


@dataclass(frozen=True)
class Smoothed:
    """What the smoother gives for one test; everything is given all outputs of the test.

    Attributes:
        m: (N, nx) smoothed means.
        U: (N, nx, nx) upper factors of the smoothed covariances, P = U'U.
        gain: (N-1, nx + nv, nx) gain of (x_k, v_k) on x_{k+1}.
        C: (N-1, rows, nx + nv) factor of Cov(x_k, v_k | x_{k+1}, y_1..y_k); rows = nv, more for a singular model.
        singular: number of predictions whose covariance was singular; there the gain has no component along the
            directions that carry no uncertainty.
    """

    m: Array
    U: Array
    gain: Array
    C: Array
    singular: int

    @property
    def chol(self) -> Array:
        """(N, nx, nx) lower factors chol_P of the smoothed covariances."""
        return self.U.transpose(0, 2, 1)

    @property
    def P(self) -> Array:
        """(N, nx, nx) smoothed covariances."""
        return self.chol @ self.U

    @property
    def lag_one(self) -> Array:
        """(N-1, nx, nx) Cov(x_{k+1}, x_k | all y): rows belong to the later sample."""
        n = self.m.shape[1]
        return self.P[1:] @ self.gain[:, :n].transpose(0, 2, 1)


def extended_kalman_smoother(filtered: Filtered, Q: Array, end: tuple[Array, Array] | None = None) -> Smoothed:
    """Smooth one test.

    Args:
        filtered: the filter's results, obtained with the same Q.
        Q: (nv, nv) process noise covariance.
        end: smoothed mean (nx,) and upper factor (nx, nx) of the last sample, where later ones have been smoothed.
    """
    N, n = filtered.m_filt.shape
    nv = filtered.G.shape[2]
    UQ = upper_factor(Q, "the process noise covariance Q")
    m, U, gain = np.empty((N, n)), np.empty((N, n, n)), np.empty((N - 1, n + nv, n))
    f = filtered
    m[-1], U[-1] = end or (f.m_filt[-1], f.U_filt[-1])
    # nv rows hold C wherever P_pred is regular, n + nv always do.
    for rows in (nv, n + nv):
        C = np.empty((N - 1, rows, n + nv))
        singular, fits = _smooth(f.m_pred, f.m_filt, f.U_filt, f.F, f.G, UQ, m, U, gain, C)
        if fits:
            break
    return Smoothed(m, U, gain, C, singular)


@routine
def backward_gain(U, F, G, UQ, gain, C, W, pivot_column, w):  # type: ignore[no-untyped-def]
    """The triangularisation of the module's text. Writes gain (n + nv, n) and C (rows, n + nv).

    Where the predicted covariance is singular, the gain has no component along directions that the others determine.
    Returns the rank of the predicted covariance.
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


@kernel(
    types.Tuple((types.int64, types.boolean))(matrix, matrix, cube, cube, cube, matrix, matrix, cube, cube, cube),
)  # fmt: skip
def _smooth(m_pred, m_filt, U_filt, F, G, UQ, m, U, gain, C):  # type: ignore[no-untyped-def]
    """Run the smoother; m, U, gain and C are written, m and U before the last sample.

    Where the filter's steps are equal the gain is that of the later one, and so is U once it has come to rest.

    Returns the number of singular predictions, and whether C had rows enough for them.
    """
    N, n = m_filt.shape
    nv = UQ.shape[0]
    rows = C.shape[1]
    W = np.empty((max(n + nv, rows + n), 2 * n + nv))
    w = np.empty(2 * n + nv)
    pivot_column = np.empty(n, dtype=np.int64)
    before = np.empty((n, n))
    alike, rests = 0, False
    rank, singular = n, 0
    for k in range(N - 2, -1, -1):
        equal = k < N - 2 and same(F[k], F[k + 1]) and same(G[k], G[k + 1]) and same(U_filt[k], U_filt[k + 1])
        rests = rests and equal
        if equal:
            copy(gain[k + 1], gain[k])
            copy(C[k + 1], C[k])
        else:
            rank = backward_gain(U_filt[k], F[k], G[k], UQ, gain[k], C[k], W, pivot_column, w)
        if rank < n:
            singular += 1
            if rank + rows < n + nv:
                return singular, False
        # Smoothed covariance: [C_x; U_{k+1} X'], the part of x_k that x_{k+1} leaves open and the part it carries.
        for i in range(n):
            m[k, i] = m_filt[k, i]
            for j in range(n):
                m[k, i] += gain[k, i, j] * (m[k + 1, j] - m_pred[k + 1, j])
        if rests:
            copy(U[k + 1], U[k])
            continue
        for r in range(rows):
            for c in range(n):
                W[r, c] = C[k, r, c]
        rows_of(U[k + 1], gain[k], 0, n, W, rows, 0)
        triangularise(W, rows + n, n, n, w)
        for r in range(n):
            for c in range(n):
                U[k, r, c] = W[r, c]
        alike = alike + 1 if equal else 0
        rests = at_rest(U[k], rows + n, before, alike)
    return singular, True

"""The sigma-point (Rauch-Tung-Striebel) smoother in square-root array form (Sarkka 2008, IEEE TAC 53:3).

Backward over the gains and factors that the filter's time updates left: nothing is subtracted and no point is drawn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import types

from noiseid_cli.filters.ekf import cube
from noiseid_cli.filters.linalg import transpose, triangularise, upper_times
from noiseid_cli.filters.sigma_filter import SigmaFiltered
from noiseid_cli.models.jit import kernel, routine
from noiseid_cli.models.recording import Array
from noiseid_cli.models.signatures import matrix
from noiseid_cli.models.vectors import blocks, clear, rows_out


@dataclass(frozen=True)
class SigmaSmoothed:
    """What the smoother gives for one test, given all outputs of the test.

    Attributes:
        m: (N, nx) smoothed means.
        U: (N, nx, nx) upper factors of the smoothed covariances, P = U'U.
        T: (N-1, nx, nx) rows of x_{k+1} that go with the rows U[k] of x_k, and V: (N-1, nx, nx) upper factor of
            Cov(x_{k+1} | x_k, all y): [U[k] T[k]; 0 V[k]] is a factor of the joint of x_k and x_{k+1}.
    """

    m: Array
    U: Array
    T: Array
    V: Array

    @property
    def P(self) -> Array:
        """(N, nx, nx) smoothed covariances."""
        return self.U.transpose(0, 2, 1) @ self.U

    @property
    def lag_one(self) -> Array:
        """(N-1, nx, nx) Cov(x_{k+1}, x_k | all y): rows belong to the later sample."""
        return self.T.transpose(0, 2, 1) @ self.U[:-1]


def sigma_point_smoother(filtered: SigmaFiltered) -> SigmaSmoothed:
    """Smooth one test.

    Args:
        filtered: the filter's results.
    """
    f = filtered
    N, n = f.m_filt.shape
    m, U, T, V = np.empty((N, n)), np.empty((N, n, n)), np.empty((N - 1, n, n)), np.empty((N - 1, n, n))
    m[-1], U[-1] = f.m_filt[-1], f.U_filt[-1]
    _smooth(f.m_pred, f.m_filt, f.gain, f.C, m, U, T, V)
    return SigmaSmoothed(m, U, T, V)


@kernel(types.void(matrix, matrix, cube, cube, matrix, cube, cube, cube), allocates=True)
def _smooth(m_pred, m_filt, gain, C, m, U, T, V):  # type: ignore[no-untyped-def]
    """Run the smoother; m, U, T and V are written, but for the last sample's m and U."""
    n = m.shape[1]
    X, W = np.zeros((n, blocks(n))), np.zeros((2 * n, blocks(2 * n)))
    _steps(m_pred, m_filt, gain, C, m, U, T, V, X, W)


@routine
def _steps(m_pred, m_filt, gain, C, m, U, T, V, X, W):  # type: ignore[no-untyped-def]
    """The loop of ``_smooth``; X (n, blocks(n)) and W (2n, blocks(2n)) are scratch, zero at first."""
    N, n = m_filt.shape
    for k in range(N - 2, -1, -1):
        for i in range(n):
            m[k, i] = m_filt[k, i]
            for j in range(n):
                m[k, i] += gain[k, i, j] * (m[k + 1, j] - m_pred[k + 1, j])
        # [U_{k+1} gain', U_{k+1}; C, 0] is a factor of (x_k, x_{k+1}); bring it to triangular form.
        transpose(gain[k], X)
        upper_times(U[k + 1], X, W, 0)
        for r in range(n):
            clear(W, n + r, n)
            for c in range(n):
                W[r, n + c] = U[k + 1, r, c]
                W[n + r, c] = C[k, r, c]
        triangularise(W, 2 * n, W.shape[1], 2 * n)
        rows_out(W, 0, 0, U[k])
        rows_out(W, 0, n, T[k])
        rows_out(W, n, n, V[k])

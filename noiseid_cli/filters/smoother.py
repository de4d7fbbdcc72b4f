"""The extended Kalman (Rauch-Tung-Striebel) smoother in square-root array form.

The filter's run towards a smoother keeps of each step the gain of (x_k, v_k) on x_{k+1} and the factor C of what
x_{k+1} leaves open of them, see ``ekf_steps.predict_joint``; the way back only carries the mean and one factor. Nothing
is subtracted and no covariance is inverted (Park & Kailath 1995, square-root RTS; with the noise as a further row it
is the disturbance smoother as well).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import types

from noiseid_cli.filters.ekf import OK, ROWS_LACKING, FilterDivergedError, cube, problem_of, run_filter
from noiseid_cli.filters.linalg import rows_of, triangularise, upper_factor
from noiseid_cli.filters.rest import at_rest
from noiseid_cli.models.arrays import copy_matrix
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.jit import kernel, routine
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording
from noiseid_cli.models.signatures import matrix

Index = np.ndarray[tuple[int], np.dtype[np.int64]]


@dataclass(frozen=True)
class Forward:
    """What a smoother needs of the filter's run over one test; k|k-1 is "pred", k|k is "filt".

    Attributes:
        m_pred, m_filt: (N, nx) means.
        U_pred, U_filt: (nx, nx) upper factors at the last sample.
        gain: (N-1, nx + nv, nx) gain of (x_k, v_k) on x_{k+1}, and C: (N-1, rows, nx + nv) factor of
            Cov(x_k, v_k | x_{k+1}, y_1..y_k), rows = nv or, for a singular model, more; both are those of step k
            at source[k], since equal steps share theirs.
        source: (N-1,) indices.
        H: (N, ny, nx) dh/dx at m_pred[k].
        innovation: (N, ny) y[k] - h(m_pred[k], u[k]); NaN where y is missing.
        loglik: log-likelihood of the observed outputs.
        singular: number of predictions whose covariance was singular; there the gain has no component along the
            directions that carry no uncertainty.
    """

    m_pred: Array
    U_pred: Array
    m_filt: Array
    U_filt: Array
    gain: Array
    C: Array
    source: Index
    H: Array
    innovation: Array
    loglik: float
    singular: int


@dataclass(frozen=True)
class Smoothed:
    """What the smoother gives for one test; everything is given all outputs of the test.

    Attributes:
        m: (N, nx) smoothed means.
        U: (N, nx, nx) upper factors of the smoothed covariances, P = U'U.
        gain: (N-1, nx + nv, nx) gain of (x_k, v_k) on x_{k+1}.
        C: (N-1, rows, nx + nv) factor of Cov(x_k, v_k | x_{k+1}, y_1..y_k).
        singular: see ``Forward``.
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


def filter_to_smooth(
    model: CompiledModel,
    recording: Recording,
    noise: NoiseValues,
    test: int = 0,
    start: tuple[Array, Array] | None = None,
) -> Forward:
    """Run the extended Kalman filter over one test and keep what a smoother needs.

    Args:
        model, recording, noise, test, start: as in ``ekf.extended_kalman_filter``.

    Raises:
        FilterDivergedError: with the sample where it happened.
        EstimationError: a covariance is not symmetric positive semidefinite.
    """
    N, n, nv, ny = recording.samples, model.nx, model.nv, model.ny
    m_pred, m_filt = np.empty((N, n)), np.empty((N, n))
    U_pred, U_filt, F, G = (np.empty((2, n, columns)) for columns in (n, n, n, nv))
    H, innovation = np.empty((N, ny, n)), np.empty((N, ny))
    gain, source = np.empty((N - 1, n + nv, n)), np.empty(N - 1, dtype=np.int64)
    first = start or (noise.m0[test], upper_factor(noise.P0, "the initial covariance P0"))
    problem = problem_of(model, recording, noise)
    # nv rows hold C wherever the predicted covariance is regular, n + nv always do.
    for rows in (nv, n + nv):
        C = np.empty((N - 1, rows, n + nv))
        m_pred[0], U_pred[0] = first
        arrays = (m_pred, U_pred, m_filt, U_filt, F, G, H, innovation, gain, C, source)
        code, step, loglik, singular = run_filter(*problem, *arrays)
        if code != ROWS_LACKING:
            break
    if code != OK:
        raise FilterDivergedError(code, step, recording)
    last = (N - 1) % 2
    return Forward(m_pred, U_pred[last], m_filt, U_filt[last], gain, C, source, H, innovation, loglik, singular)


def extended_kalman_smoother(forward: Forward, end: tuple[Array, Array] | None = None) -> Smoothed:
    """Smooth one test.

    Args:
        forward: the filter's run.
        end: smoothed mean (nx,) and upper factor (nx, nx) of the last sample, where later ones have been smoothed.
    """
    f = forward
    N, n = f.m_filt.shape
    m, U = np.empty((N, n)), np.empty((N, n, n))
    m[-1], U[-1] = end or (f.m_filt[-1], f.U_filt)
    _smooth(f.m_pred, f.m_filt, f.gain, f.C, f.source, m, U)
    return Smoothed(m, U, f.gain[f.source], f.C[f.source], f.singular)


@routine
def carry_mean(m_filt, m_pred_next, m_next, gain, m):  # type: ignore[no-untyped-def]
    """Write the smoothed mean of x_k to m, given that of x_{k+1}."""
    n = m.shape[0]
    for i in range(n):
        m[i] = m_filt[i]
        for j in range(n):
            m[i] += gain[i, j] * (m_next[j] - m_pred_next[j])


@routine
def carry_factor(U_next, gain, C, U, W, w):  # type: ignore[no-untyped-def]
    """Write the factor of the smoothed covariance of x_k to U, given that of x_{k+1}.

    It is that of [C_x; U_next X'], the part of x_k that x_{k+1} leaves open and the part that it carries.
    W (>= rows + n, n) and w (n,) are scratch.
    """
    n, rows = U.shape[0], C.shape[0]
    for r in range(rows):
        for c in range(n):
            W[r, c] = C[r, c]
    rows_of(U_next, gain, 0, n, W, rows, 0)
    triangularise(W, rows + n, n, n, w)
    for r in range(n):
        for c in range(n):
            U[r, c] = W[r, c]


@kernel(types.void(matrix, matrix, cube, cube, types.int64[::1], matrix, cube))
def _smooth(m_pred, m_filt, gain, C, source, m, U):  # type: ignore[no-untyped-def]
    """Run the smoother; m and U are written before the last sample.

    Where steps are equal and U has come to rest, it is that of the later sample, see ``rest``.
    """
    N, n = m_filt.shape
    rows = C.shape[1]
    W, w, before = np.empty((rows + n, n)), np.empty(n), np.empty((2, n, n))
    alike, rests = 0, False
    for k in range(N - 2, -1, -1):
        s = source[k]
        equal = k < N - 2 and s == source[k + 1]
        rests = rests and equal
        carry_mean(m_filt[k], m_pred[k + 1], m[k + 1], gain[s], m[k])
        if rests:
            copy_matrix(U[k + 1], U[k])
            continue
        carry_factor(U[k + 1], gain[s], C[s], U[k], W, w)
        alike = alike + 1 if equal else 0
        rests = at_rest(U[k], rows + n, before, alike)

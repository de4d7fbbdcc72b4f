"""The extended Kalman (Rauch-Tung-Striebel) smoother in square-root array form.

The filter's run towards a smoother keeps of each step the gain of (x_k, v_k) on x_{k+1} and the factor C of what
x_{k+1} leaves open of them, see ``ekf_steps.predict_joint``; the way back only carries the mean and one factor. Nothing
is subtracted and no covariance is inverted (Park & Kailath 1995, square-root RTS; with the noise as a further row it
is the disturbance smoother as well).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import types

from noiseid_cli.filters.ekf import OK, ROWS_LACKING, FilterDivergedError, cube, problem_of, run_filter
from noiseid_cli.filters.linalg import triangularise, upper_factor, upper_times
from noiseid_cli.filters.rest import at_rest
from noiseid_cli.models.arrays import copy_matrix
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.jit import allocating, kernel, routine
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording
from noiseid_cli.models.signatures import matrix
from noiseid_cli.models.vectors import blocks, rows_in, rows_out

Index = np.ndarray[tuple[int], np.dtype[np.int64]]


@dataclass(frozen=True)
class Forward:
    """What a smoother needs of the filter's run over one test; k|k-1 is "pred", k|k is "filt".

    Attributes:
        m_pred, m_filt: (N, nx) means.
        U_pred, U_filt: (nx, nx) upper factors at the last sample.
        gain_t: (N-1, nx, nx + nv) transposed gain of (x_k, v_k) on x_{k+1}, and C: (N-1, rows, nx + nv) factor
            of Cov(x_k, v_k | x_{k+1}, y_1..y_k), rows = nv or, for a singular model, more; both are those of step
            k at source[k], since equal steps share theirs.
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
    gain_t: Array
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
    gain_t, source = np.empty((N - 1, n, n + nv)), np.empty(N - 1, dtype=np.int64)
    first = start or (noise.m0[test], upper_factor(noise.P0, "the initial covariance P0"))
    problem = problem_of(model, recording, noise)
    # nv rows hold C wherever the predicted covariance is regular, n + nv always do.
    for rows in (nv, n + nv):
        C = np.empty((N - 1, rows, n + nv))
        m_pred[0], U_pred[0] = first
        arrays = (m_pred, U_pred, m_filt, U_filt, F, G, H, innovation, gain_t, C, source)
        code, step, loglik, singular = run_filter(*problem, *arrays)
        if code != ROWS_LACKING:
            break
    if code != OK:
        raise FilterDivergedError(code, step, recording)
    last = (N - 1) % 2
    return Forward(m_pred, U_pred[last], m_filt, U_filt[last], gain_t, C, source, H, innovation, loglik, singular)


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
    _smooth(f.m_pred, f.m_filt, f.gain_t, f.C, f.source, m, U)
    return Smoothed(m, U, f.gain_t[f.source].transpose(0, 2, 1), f.C[f.source], f.singular)


class Scratch(NamedTuple):
    """Matrices that the way back works in; rows are as long as their blocks of eight."""

    X: Any  # (n, blocks(n + nv)), the transposed gain
    W: Any  # (rows + n, blocks(n + nv)), the joint of (x_k, v_k)


@allocating
def scratch(n, nv, rows):  # type: ignore[no-untyped-def]
    """Make the scratch matrices."""
    return Scratch(np.zeros((n, blocks(n + nv))), np.zeros((rows + n, blocks(n + nv))))


@routine
def carry_mean(m_filt, m_pred_next, m_next, gain_t, m):  # type: ignore[no-untyped-def]
    """Write the smoothed mean of x_k to m, given that of x_{k+1}."""
    n = np.uint64(m.shape[0])
    for i in range(n):
        m[i] = m_filt[i]
    for j in range(n):
        shift = m_next[j] - m_pred_next[j]
        for i in range(n):
            m[i] += gain_t[j, i] * shift


@routine
def carry_joint(U_next, gain_t, C, s):  # type: ignore[no-untyped-def]
    """Write a factor of the smoothed covariance of (x_k, v_k) to W, given that of x_{k+1}.

    It is [C; U_next X'], the part that x_{k+1} leaves open and the part that it carries.
    """
    rows = C.shape[0]
    rows_in(C, s.W, 0)
    rows_in(gain_t, s.X, 0)
    upper_times(U_next, s.X, s.W, rows)


@routine
def carry_factor(s, U):  # type: ignore[no-untyped-def]
    """Write the triangular factor of the smoothed covariance of x_k to U, from ``carry_joint``; W is overwritten."""
    n = U.shape[0]
    triangularise(s.W, s.W.shape[0], blocks(n), n)
    rows_out(s.W, 0, 0, U)


@kernel(types.void(matrix, matrix, cube, cube, types.int64[::1], matrix, cube), allocates=True)
def _smooth(m_pred, m_filt, gain_t, C, source, m, U):  # type: ignore[no-untyped-def]
    """Run the smoother; m and U are written before the last sample."""
    n, rows, columns = m.shape[1], C.shape[1], C.shape[2]
    _steps(m_pred, m_filt, gain_t, C, source, m, U, np.empty((2, n, n)), scratch(n, columns - n, rows))


@routine
def _steps(m_pred, m_filt, gain_t, C, source, m, U, before, s):  # type: ignore[no-untyped-def]
    """The loop of ``_smooth``; where steps are equal and U has come to rest, it is that of the later sample."""
    N, n = m_filt.shape
    alike, rests = 0, False
    for k in range(N - 2, -1, -1):
        at = source[k]
        equal = k < N - 2 and at == source[k + 1]
        rests = rests and equal
        carry_mean(m_filt[k], m_pred[k + 1], m[k + 1], gain_t[at], m[k])
        if rests:
            copy_matrix(U[k + 1], U[k])
            continue
        carry_joint(U[k + 1], gain_t[at], C[at], s)
        carry_factor(s, U[k])
        alike = alike + 1 if equal else 0
        rests = at_rest(U[k], C.shape[1] + n, before, alike)

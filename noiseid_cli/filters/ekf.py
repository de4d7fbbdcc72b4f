"""The extended Kalman filter in square-root array form.

Model (axelsson2011_poster, eq. 1): x_{k+1} = F1(x_k, u_k) + F2(x_k) v_k, y_k = h(x_k, u_k) + e_k, x_1 ~ N(m0, P0).
One step of it: ``ekf_steps``; factors are upper triangles U with P = U'U, see ``filters.linalg``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import types

from noiseid_cli.errors import NoiseidError
from noiseid_cli.filters.ekf_steps import correct, predict, predict_joint, scratch, update
from noiseid_cli.filters.linalg import upper_factor
from noiseid_cli.filters.rest import at_rest, same
from noiseid_cli.models.arrays import copy_matrix
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.discretisation import transition, workspace
from noiseid_cli.models.jit import kernel, routine
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording
from noiseid_cli.models.signatures import DriftJacobian, OutputJacobian, matrix, vector

OK, NOT_FINITE, SINGULAR_INNOVATION, ROWS_LACKING = 0, 1, 2, -1
_WHY = {
    NOT_FINITE: "the estimate is no longer finite",
    SINGULAR_INNOVATION: "the innovation covariance is singular (an output is exactly known beforehand)",
    3: "the covariance of the propagated sigma points is indefinite (take a larger alpha)",
    4: "the covariance of the predicted outputs is indefinite (take a larger alpha)",
    5: "the corrected covariance is indefinite (take a larger alpha)",
    6: "the covariance of the state is singular, and its factor has no derivative (give every state some noise)",
}

cube = types.float64[:, :, ::1]


class FilterDivergedError(NoiseidError):
    """The filter left the finite numbers, or met a singular innovation covariance."""

    def __init__(self, code: int, step: int, recording: Recording) -> None:
        """Say what failed, in which test and at which sample."""
        self.code, self.step = code, step
        super().__init__(
            f"test {recording.name!r}: {self.words(code)} at sample {step + 1} of {recording.samples} "
            f"(t = {recording.time[step]:.6g} s)"
        )

    @staticmethod
    def words(code: int) -> str:
        """What a filter's code means."""
        return _WHY[code]


@dataclass(frozen=True)
class Filtered:
    """What the filter gives for one test; k is the sample, "pred" is k|k-1 and "filt" is k|k.

    Attributes:
        m_pred, m_filt: (N, nx) means.
        U_pred, U_filt: (N, nx, nx) upper factors, P = U'U.
        F: (N-1, nx, nx) dF1/dx at m_filt[k]; G: (N-1, nx, nv) F2 there.
        H: (N, ny, nx) dh/dx at m_pred[k].
        innovation: (N, ny) y[k] - h(m_pred[k], u[k]); NaN where y is missing.
        R: (ny, ny) the measurement noise covariance that was used.
        loglik: log-likelihood of the observed outputs, with the -m/2 log 2 pi term.
    """

    m_pred: Array
    U_pred: Array
    m_filt: Array
    U_filt: Array
    F: Array
    G: Array
    H: Array
    innovation: Array
    R: Array
    loglik: float

    @property
    def chol_filt(self) -> Array:
        """(N, nx, nx) lower factors chol_P of the filtered covariance, P = chol_P chol_P'."""
        return self.U_filt.transpose(0, 2, 1)

    @property
    def chol_pred(self) -> Array:
        """(N, nx, nx) lower factors of the predicted covariance."""
        return self.U_pred.transpose(0, 2, 1)

    @property
    def S(self) -> Array:
        """(N, ny, ny) innovation covariances H P_pred H' + R, of missing outputs too."""
        A = self.U_pred @ self.H.transpose(0, 2, 1)
        return A.transpose(0, 2, 1) @ A + self.R


def extended_kalman_filter(
    model: CompiledModel,
    recording: Recording,
    noise: NoiseValues,
    test: int = 0,
    start: tuple[Array, Array] | None = None,
) -> Filtered:
    """Filter one test.

    Args:
        model: the compiled model.
        recording: the test; NaN in y is a missing output.
        noise: Q, R, P0 and the rows of m0, of which row ``test`` is used.
        test: which row of ``noise.m0`` belongs to this test.
        start: predicted mean (nx,) and upper factor (nx, nx) of the first sample, where they are not m0 and P0.

    Raises:
        FilterDivergedError: with the sample where it happened.
        EstimationError: a covariance is not symmetric positive semidefinite.
    """
    N, n, nv, ny = recording.samples, model.nx, model.nv, model.ny
    m_pred, m_filt = np.empty((N, n)), np.empty((N, n))
    U_pred, U_filt = np.empty((N, n, n)), np.empty((N, n, n))
    F, G, H = np.empty((N - 1, n, n)), np.empty((N - 1, n, nv)), np.empty((N, ny, n))
    innovation = np.empty((N, ny))
    m_pred[0], U_pred[0] = start or (noise.m0[test], upper_factor(noise.P0, "the initial covariance P0"))
    arrays = (m_pred, U_pred, m_filt, U_filt, F, G, H, innovation)
    unwanted = (np.empty((0, n, n + nv)), np.empty((0, nv, n + nv)), np.empty(0, dtype=np.int64))
    code, step, loglik, _ = run_filter(*problem_of(model, recording, noise), *arrays, *unwanted)
    if code != OK:
        raise FilterDivergedError(code, step, recording)
    return Filtered(m_pred, U_pred, m_filt, U_filt, F, G, H, innovation, noise.R, loglik)


def problem_of(model: CompiledModel, recording: Recording, noise: NoiseValues) -> tuple[Any, ...]:
    """What ``run_filter`` reads: the model, the test and the factors of Q and R.

    Raises:
        EstimationError: a covariance is not symmetric positive semidefinite.
    """
    return (
        model.scheme,
        model.drift_jacobian,
        model.output_jacobian,
        model.parameters,
        np.ascontiguousarray(recording.dt),
        np.ascontiguousarray(recording.u),
        np.ascontiguousarray(recording.y),
        upper_factor(noise.Q, "the process noise covariance Q"),
        upper_factor(noise.R, "the measurement noise covariance R"),
    )


@routine
def _same_measured(innovation, other):  # type: ignore[no-untyped-def]
    """Whether the same outputs were measured at two samples."""
    alike = True
    for i in range(innovation.shape[0]):
        alike = alike and math.isnan(innovation[i]) == math.isnan(other[i])
    return alike


@kernel(
    types.Tuple((types.int64, types.int64, types.float64, types.int64))(
        types.int64, DriftJacobian, OutputJacobian, vector, vector, matrix, matrix, matrix, matrix,
        matrix, cube, matrix, cube, cube, cube, cube, matrix, cube, cube, types.int64[::1],
    ),
    allocates=True,
)  # fmt: skip
def run_filter(  # type: ignore[no-untyped-def]
    scheme, drift_jacobian, output_jacobian, p, dt, u, y, UQ, UR,
    m_pred, U_pred, m_filt, U_filt, F, G, H, innovation, gain_t, C, source,
):  # fmt: skip
    """Run the filter; the arrays from m_pred on are written.

    Where the steps are equal and the covariances have come to rest, only the means are computed, see ``rest``. Given
    arrays for gain_t and C, see ``predict_joint``, it gathers what a smoother needs; source[k] is where step k has its
    own. U_pred, U_filt, F and G may then have room for two samples only, which are used in turns.

    Returns:
        Code, sample, log-likelihood, and number of singular predictions, which are counted for a smoother.
    """
    n, nv, ny = m_pred.shape[1], UQ.shape[0], UR.shape[0]
    return _steps(
        scheme, drift_jacobian, output_jacobian, p, dt, u, y, UQ, UR,
        m_pred, U_pred, m_filt, U_filt, F, G, H, innovation, gain_t, C, source,
        np.empty(ny), np.empty((2, n, n)), workspace(n, nv), scratch(n, nv, ny, len(gain_t) > 0),
    )  # fmt: skip


@routine
def _steps(  # type: ignore[no-untyped-def]
    scheme, drift_jacobian, output_jacobian, p, dt, u, y, UQ, UR,
    m_pred, U_pred, m_filt, U_filt, F, G, H, innovation, gain_t, C, source,
    y_hat, before, work, s,
):  # fmt: skip
    """The loop of ``run_filter``; y_hat (ny,), before (2, n, n), work and s are scratch."""
    N, n = m_pred.shape
    nv = UQ.shape[0]
    ny = UR.shape[0]
    joint = len(gain_t) > 0
    turns = len(U_pred) < N
    alike, rests = 0, False
    loglik = 0.0
    rank, singular = n, 0
    for k in range(N):
        now, last, after = (k % 2, 1 - k % 2, 1 - k % 2) if turns else (k, k - 1, k + 1)
        output_jacobian(m_pred[k], u[k], p, y_hat, H[k])
        for i in range(ny):
            innovation[k, i] = y[k, i] - y_hat[i]
            if not math.isfinite(innovation[k, i]) and math.isfinite(y[k, i]):
                return NOT_FINITE, k, math.nan, singular
        equal = k > 0 and same(H[k], H[k - 1]) and _same_measured(innovation[k], innovation[k - 1])
        rests = rests and equal
        if rests:
            # W still holds the triangularised joint of this y and x.
            q = 0
            for i in range(ny):
                if not math.isnan(innovation[k, i]):
                    s.e[q] = innovation[k, i]
                    q += 1
            rise = correct(s.W, q, m_pred[k], s.e, m_filt[k])
            copy_matrix(U_filt[last], U_filt[now])
        else:
            rise = update(m_pred[k], U_pred[now], H[k], innovation[k], UR, m_filt[k], U_filt[now], s)
        if not math.isfinite(rise):
            return SINGULAR_INNOVATION if math.isnan(rise) else NOT_FINITE, k, math.nan, singular
        loglik += rise
        for i in range(n):
            if not math.isfinite(m_filt[k, i]) or not math.isfinite(U_filt[now, i, i]):
                return NOT_FINITE, k, math.nan, singular
        if k == N - 1:
            break
        transition(scheme, drift_jacobian, m_filt[k], u[k], dt[k], p, m_pred[k + 1], F[now], G[now], work)
        equal = equal and same(F[now], F[last]) and same(G[now], G[last])
        rests = rests and equal
        if rests:
            copy_matrix(U_pred[now], U_pred[after])
        elif joint:
            rank = predict_joint(U_filt[now], F[now], G[now], UQ, U_pred[after], gain_t[k], C[k], s)
        else:
            predict(U_filt[now], F[now], G[now], UQ, U_pred[after], s)
        if joint:
            source[k] = source[k - 1] if rests else k
            singular += rank < n
            if rank + C.shape[1] < n + nv:
                return ROWS_LACKING, k, math.nan, singular
        if not rests:
            alike = alike + 1 if equal else 0
            rests = at_rest(U_pred[after], n + max(nv, ny), before, alike)
    return OK, N, loglik, singular

"""The extended Kalman filter in square-root array form.

Model (axelsson2011_poster, eq. 1): x_{k+1} = F1(x_k, u_k) + F2(x_k) v_k, y_k = h(x_k, u_k) + e_k, x_1 ~ N(m0, P0).
Each update and each prediction is one orthogonal triangularisation (Kailath, Sayed & Hassibi, Linear Estimation,
ch. 12); factors are upper triangles U with P = U'U, see ``filters.linalg``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import types

from noiseid_cli.errors import NoiseidError
from noiseid_cli.filters.linalg import rows_of, triangularise, upper_factor
from noiseid_cli.filters.rest import at_rest, copy, same
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.discretisation import transition, workspace
from noiseid_cli.models.jit import kernel, routine
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording
from noiseid_cli.models.signatures import DriftJacobian, OutputJacobian, matrix, vector

OK, NOT_FINITE, SINGULAR_INNOVATION = 0, 1, 2
_WHY = {
    NOT_FINITE: "the estimate is no longer finite",
    SINGULAR_INNOVATION: "the innovation covariance is singular (an output is exactly known beforehand)",
    3: "the covariance of the propagated sigma points is indefinite (take a larger alpha)",
    4: "the covariance of the predicted outputs is indefinite (take a larger alpha)",
    5: "the corrected covariance is indefinite (take a larger alpha)",
    6: "the covariance of the state is singular, and its factor has no derivative (give every state some noise)",
}

cube = types.float64[:, :, ::1]
LOG_2PI = math.log(2.0 * math.pi)


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
    code, step, loglik = _filter(
        model.scheme,
        model.drift_jacobian,
        model.output_jacobian,
        model.parameters,
        np.ascontiguousarray(recording.dt),
        np.ascontiguousarray(recording.u),
        np.ascontiguousarray(recording.y),
        upper_factor(noise.Q, "the process noise covariance Q"),
        upper_factor(noise.R, "the measurement noise covariance R"),
        m_pred,
        U_pred,
        m_filt,
        U_filt,
        F,
        G,
        H,
        innovation,
    )
    if code != OK:
        raise FilterDivergedError(code, step, recording)
    return Filtered(m_pred, U_pred, m_filt, U_filt, F, G, H, innovation, noise.R, loglik)


@routine
def update(m, U, H, innovation, UR, m_out, U_out, W, w, e):  # type: ignore[no-untyped-def]
    """Measurement update: one triangularisation of [UR 0; U H', U] over the observed outputs.

    It gives [US, US^-T H P; 0, U_filt], S = US'US. Writes m_out, U_out; returns the log-likelihood of the
    innovation, NaN if S is singular.

    Args:
        m, U: predicted mean (n,) and factor (n, n).
        H: (ny, n); innovation: (ny,), NaN where missing; UR: (ny, ny) factor of R.
        m_out, U_out: outputs, may not alias U.
        W, w, e: scratch (ny + n, ny + n), (ny + n,), (ny,).
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
    for c in range(n):
        for r in range(ny):
            W[r, q + c] = 0.0
        for r in range(n):
            W[ny + r, q + c] = U[r, c]
    if q == 0:
        for c in range(n):
            m_out[c] = m[c]
            for r in range(n):
                U_out[r, c] = U[r, c] if r <= c else 0.0
        return 0.0
    return condition(W, ny + n, q, m, e, m_out, U_out, w)


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
def _same_measured(innovation, other):  # type: ignore[no-untyped-def]
    """Whether the same outputs were measured at two samples."""
    alike = True
    for i in range(innovation.shape[0]):
        alike = alike and math.isnan(innovation[i]) == math.isnan(other[i])
    return alike


@kernel(
    types.Tuple((types.int64, types.int64, types.float64))(
        types.int64, DriftJacobian, OutputJacobian, vector, vector, matrix, matrix, matrix, matrix,
        matrix, cube, matrix, cube, cube, cube, cube, matrix,
    ),
)  # fmt: skip
def _filter(  # type: ignore[no-untyped-def]
    scheme, drift_jacobian, output_jacobian, p, dt, u, y, UQ, UR,
    m_pred, U_pred, m_filt, U_filt, F, G, H, innovation,
):  # fmt: skip
    """Run the filter; the arrays from m_pred on are written. Returns (code, sample, log-likelihood).

    Where the steps are equal and the covariances have come to rest, only the means are computed, see ``rest``.
    """
    N, n = m_pred.shape
    nv = UQ.shape[0]
    ny = UR.shape[0]
    y_hat = np.empty(ny)
    W = np.empty((ny + n, ny + n))
    w = np.empty(ny + n)
    e = np.empty(ny)
    W_pred = np.empty((n + nv, n))
    work = workspace(n, nv)
    before = np.empty((n, n))
    alike, rests = 0, False
    loglik = 0.0
    for k in range(N):
        output_jacobian(m_pred[k], u[k], p, y_hat, H[k])
        for i in range(ny):
            innovation[k, i] = y[k, i] - y_hat[i]
            if not math.isfinite(innovation[k, i]) and math.isfinite(y[k, i]):
                return NOT_FINITE, k, math.nan
        equal = k > 0 and same(H[k], H[k - 1]) and _same_measured(innovation[k], innovation[k - 1])
        rests = rests and equal
        if rests:
            # W still holds the triangularised joint of this y and x.
            q = 0
            for i in range(ny):
                if not math.isnan(innovation[k, i]):
                    e[q] = innovation[k, i]
                    q += 1
            gain = correct(W, q, m_pred[k], e, m_filt[k])
            copy(U_filt[k - 1], U_filt[k])
        else:
            gain = update(m_pred[k], U_pred[k], H[k], innovation[k], UR, m_filt[k], U_filt[k], W, w, e)
        if not math.isfinite(gain):
            return SINGULAR_INNOVATION if math.isnan(gain) else NOT_FINITE, k, math.nan
        loglik += gain
        for i in range(n):
            if not math.isfinite(m_filt[k, i]) or not math.isfinite(U_filt[k, i, i]):
                return NOT_FINITE, k, math.nan
        if k < N - 1:
            transition(scheme, drift_jacobian, m_filt[k], u[k], dt[k], p, m_pred[k + 1], F[k], G[k], work)
            equal = equal and same(F[k], F[k - 1]) and same(G[k], G[k - 1])
            rests = rests and equal
            if rests:
                copy(U_pred[k], U_pred[k + 1])
            else:
                predict(U_filt[k], F[k], G[k], UQ, U_pred[k + 1], W_pred, w)
                alike = alike + 1 if equal else 0
                rests = at_rest(U_pred[k + 1], n + max(nv, ny), before, alike)
    return OK, N, loglik

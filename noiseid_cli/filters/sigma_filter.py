"""The sigma-point (unscented, cubature) Kalman filter in square-root array form.

Model as in ``filters.ekf``. Sigma points carry x through F1, F2 and h (Julier & Uhlmann 2004; Arasaratnam & Haykin
2009); v and e enter linearly and are integrated exactly, so that Cov x_{k+1} = Cov F1(x) + E[F2(x) Q F2(x)'].
Every covariance is a stack of rows (``sigma_rows``) and one orthogonal triangularisation. The joint of x_{k+1} and
x_k that the time update triangularises is what the smoother needs, which is therefore kept.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import types

from noiseid_cli.filters.ekf import NOT_FINITE, OK, SINGULAR_INNOVATION, FilterDivergedError, cube
from noiseid_cli.filters.linalg import upper_factor
from noiseid_cli.filters.sigma_points import SigmaWeights, draw
from noiseid_cli.filters.sigma_rows import pair_centre, split
from noiseid_cli.filters.sigma_updates import correct, joint, propagate, scratch
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.discretisation import workspace
from noiseid_cli.models.jit import kernel, routine
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording
from noiseid_cli.models.signatures import DriftJacobian, Output, matrix, vector


@dataclass(frozen=True)
class SigmaFiltered:
    """What the filter gives for one test; names as in ``ekf.Filtered``.

    Attributes:
        m_pred, m_filt: (N, nx) means.
        U_pred, U_filt: (N, nx, nx) upper factors, P = U'U.
        S: (N, ny, ny) innovation covariances, of missing outputs too.
        innovation: (N, ny), NaN where y is missing.
        gain: (N-1, nx, nx) gain of x_k on x_{k+1}, for the smoother.
        C: (N-1, nx, nx) upper factor of Cov(x_k | x_{k+1}, y_1..y_k).
        loglik: log-likelihood of the observed outputs under the Gaussian that the sigma points give.
        singular: number of predictions with a singular covariance.
    """

    m_pred: Array
    U_pred: Array
    m_filt: Array
    U_filt: Array
    S: Array
    innovation: Array
    gain: Array
    C: Array
    loglik: float
    singular: int


def sigma_point_filter(
    model: CompiledModel, recording: Recording, noise: NoiseValues, weights: SigmaWeights, test: int = 0
) -> SigmaFiltered:
    """Filter one test.

    Args:
        model, recording, noise, test: as in ``ekf.extended_kalman_filter``.
        weights: those of ``sigma_points.unscented`` or ``cubature`` for nx states.

    Raises:
        FilterDivergedError: with the sample where it happened.
        EstimationError: a covariance is not symmetric positive semidefinite, or the weights give negative variances.
    """
    N, n, ny = recording.samples, model.nx, model.ny
    m_pred, m_filt = np.empty((N, n)), np.empty((N, n))
    U_pred, U_filt, S = np.empty((N, n, n)), np.empty((N, n, n)), np.empty((N, ny, ny))
    gain, C, innovation = np.empty((N - 1, n, n)), np.empty((N - 1, n, n)), np.empty((N, ny))
    m_pred[0] = noise.m0[test]
    U_pred[0] = upper_factor(noise.P0, "the initial covariance P0")
    code, step, loglik, singular = _filter(
        model.scheme,
        model.drift_jacobian,
        model.output,
        model.parameters,
        np.ascontiguousarray(recording.dt),
        np.ascontiguousarray(recording.u),
        np.ascontiguousarray(recording.y),
        upper_factor(noise.Q, "the process noise covariance Q"),
        upper_factor(noise.R, "the measurement noise covariance R"),
        weights.eta,
        pair_centre(weights, n),
        m_pred,
        U_pred,
        m_filt,
        U_filt,
        S,
        innovation,
        gain,
        C,
    )
    if code != OK:
        raise FilterDivergedError(code, step, recording)
    return SigmaFiltered(m_pred, U_pred, m_filt, U_filt, S, innovation, gain, C, loglik, singular)


@kernel(
    types.Tuple((types.int64, types.int64, types.float64, types.int64))(
        types.int64, DriftJacobian, Output, vector, vector, matrix, matrix, matrix, matrix, types.float64,
        types.float64, matrix, cube, matrix, cube, cube, matrix, cube, cube,
    ),
    allocates=True,
)  # fmt: skip
def _filter(  # type: ignore[no-untyped-def]
    scheme, drift_jacobian, output, p, dt, u, y, UQ, UR, eta, centre,
    m_pred, U_pred, m_filt, U_filt, S, innovation, gain, C,
):  # fmt: skip
    """Run the filter; the arrays from m_pred on are written.

    Returns (code, sample, log-likelihood, number of singular predictions).
    """
    n, nv, ny = m_pred.shape[1], UQ.shape[0], UR.shape[0]
    return _steps(
        scheme, drift_jacobian, output, p, dt, u, y, UQ, UR, eta, centre,
        m_pred, U_pred, m_filt, U_filt, S, innovation, gain, C, workspace(n, nv), scratch(n, nv, ny),
    )  # fmt: skip


@routine
def _steps(  # type: ignore[no-untyped-def]
    scheme, drift_jacobian, output, p, dt, u, y, UQ, UR, eta, centre,
    m_pred, U_pred, m_filt, U_filt, S, innovation, gain, C, work, s,
):  # fmt: skip
    """The loop of ``_filter``; work and s are scratch."""
    N, n = m_pred.shape
    ny = UR.shape[0]
    loglik, singular = 0.0, 0
    for k in range(N):
        draw(m_pred[k], U_pred[k], eta, s.X)
        for i in range(2 * n + 1):
            output(s.X[i], u[k], p, s.Y[i])
        split(s.Y, eta, centre, s.y_hat, s.D)
        for i in range(ny):
            innovation[k, i] = y[k, i] - s.y_hat[i]
            if not math.isfinite(innovation[k, i]) and math.isfinite(y[k, i]):
                return NOT_FINITE, k, math.nan, singular
            for j in range(ny):
                S[k, i, j] = 0.0
                for r in range(ny):
                    S[k, i, j] += UR[r, i] * UR[r, j]
                for r in range(2 * n):
                    S[k, i, j] += s.D[r, i] * s.D[r, j]
        added = correct(m_pred[k], U_pred[k], s.D, innovation[k], UR, m_filt[k], U_filt[k], s.W, s.e)
        if not math.isfinite(added):
            return SINGULAR_INNOVATION if math.isnan(added) else NOT_FINITE, k, math.nan, singular
        loglik += added
        for i in range(n):
            if not math.isfinite(m_filt[k, i]) or not math.isfinite(U_filt[k, i, i]):
                return NOT_FINITE, k, math.nan, singular
        if k < N - 1:
            draw(m_filt[k], U_filt[k], eta, s.X)
            propagate(scheme, drift_jacobian, s.X, u[k], dt[k], p, UQ, s.x_next, s.F, s.G, s.values, work)
            rank = joint(
                s.values, UQ, eta, centre, U_filt[k], m_pred[k + 1], U_pred[k + 1], gain[k], C[k],
                s.mean, s.rows, s.W_pred, s.pivot_column,
            )  # fmt: skip
            singular += 1 if rank < n else 0
    return OK, N, loglik, singular

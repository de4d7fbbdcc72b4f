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
from noiseid_cli.filters.ekf_steps import condition
from noiseid_cli.filters.linalg import echelon, triangularise, upper_factor
from noiseid_cli.filters.sigma_points import SigmaWeights, draw
from noiseid_cli.filters.sigma_rows import pair_centre, split
from noiseid_cli.models.arrays import copy, copy_matrix
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.discretisation import transition, workspace
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


@routine
def correct(m, U, D, innovation, UR, m_out, U_out, W, e):  # type: ignore[no-untyped-def]
    """Measurement update: one triangularisation of [UR 0; D_odd U; D_even 0] over the observed outputs.

    Args:
        m, U: predicted mean (n,) and factor (n, n).
        D: (2n, ny) factor rows of h at the points; innovation: (ny,), NaN where missing; UR: (ny, ny).
        m_out, U_out: outputs, may not alias U.
        W, e: scratch (ny + 2n, ny + n), (ny,).

    Returns:
        The log-likelihood of the innovation, NaN if its covariance is singular.
    """
    ny, n = UR.shape[0], m.shape[0]
    q = 0
    for i in range(ny):
        if not math.isnan(innovation[i]):
            copy(UR[:, i], W[:ny, q])
            copy(D[:, i], W[ny:, q])
            e[q] = innovation[i]
            q += 1
    if q == 0:
        copy(m, m_out)
        copy_matrix(U, U_out)
        return 0.0
    for c in range(n):
        for r in range(ny + 2 * n):
            W[r, q + c] = U[r - ny, c] if ny <= r <= ny + c else 0.0
    return condition(W, ny + 2 * n, q, m, e, m_out, U_out)


@routine
def joint(values, UQ, eta, centre, U, m_next, U_next, gain, C, mean, rows, W, pivot_column):  # type: ignore[no-untyped-def]
    """Time update from the values of [F1, F2 UQ'] at the points, with the smoother's gain and factor.

    One triangularisation of [O U; E 0; (E F2 UQ')' 0; spread of F2 UQ' 0], O and E the odd and even rows of F1.

    Args:
        values: (2n + 1, n + nv n), per point F1 and the columns of F2 UQ'.
        UQ: (nv, nv); eta, centre: see ``sigma_rows``; U: (n, n) factor of x_k.
        m_next, U_next, gain, C: outputs (n,), (n, n), (n, n), (n, n).
        mean, rows, W, pivot_column: scratch.

    Returns:
        The rank of the predicted covariance.
    """
    n, nv = U.shape[0], UQ.shape[0]
    split(values, eta, centre, mean, rows)
    count = 2 * n + nv
    W[:, :] = 0.0
    for c in range(n):
        m_next[c] = mean[c]
        for r in range(2 * n):
            W[r, c] = rows[r, c]
        for r in range(c + 1):
            W[r, n + c] = U[r, c]
        for j in range(nv):
            W[2 * n + j, c] = mean[n + j * n + c]
    # A gain that is the same at all points has no spread: its rows are left out.
    for j in range(nv):
        for r in range(2 * n):
            size = 0.0
            for c in range(n):
                size += abs(rows[r, n + j * n + c])
            if size > 0.0:
                for c in range(n):
                    W[count, c] = rows[r, n + j * n + c]
                count += 1
    rank = echelon(W, count, 2 * n, n, pivot_column)
    for r in range(n):
        for c in range(n):
            U_next[r, c] = W[r, c] if r < rank else 0.0
    gain[:, :] = 0.0
    for i in range(rank - 1, -1, -1):
        pivot = pivot_column[i]
        for j in range(n):
            total = W[i, n + j]
            for c in range(i + 1, rank):
                total -= W[i, pivot_column[c]] * gain[j, pivot_column[c]]
            gain[j, pivot] = total / W[i, pivot]
    # What x_{k+1} leaves open of x_k stands below.
    left = count - rank
    for r in range(left):
        for c in range(n):
            W[r, c] = W[rank + r, n + c]
    triangularise(W, left, n, n)
    for r in range(n):
        for c in range(n):
            C[r, c] = W[r, c] if r <= c and r < left else 0.0
    return rank


@routine
def propagate(scheme, drift_jacobian, X, u, dt, p, UQ, x_next, F, G, values, work):  # type: ignore[no-untyped-def]
    """Write F1 and the columns of F2 UQ' at each of the points X to ``values``, see ``joint``."""
    n, nv = G.shape
    for i in range(X.shape[0]):
        transition(scheme, drift_jacobian, X[i], u, dt, p, x_next, F, G, work)
        for r in range(n):
            values[i, r] = x_next[r]
            for j in range(nv):
                total = 0.0
                for c in range(j, nv):
                    total += G[r, c] * UQ[j, c]
                values[i, n + j * n + r] = total


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
    N, n = m_pred.shape
    nv = UQ.shape[0]
    ny = UR.shape[0]
    columns = n + nv * n
    X = np.empty((2 * n + 1, n))
    Y = np.empty((2 * n + 1, ny))
    D, y_hat = np.empty((2 * n, ny)), np.empty(ny)
    W = np.empty((ny + 2 * n, ny + n))
    e = np.empty(ny)
    values = np.empty((2 * n + 1, columns))
    mean, rows = np.empty(columns), np.empty((2 * n, columns))
    W_pred = np.empty((2 * n + nv + 2 * n * nv, 2 * n))
    pivot_column = np.empty(n, dtype=np.int64)
    x_next, F, G = np.empty(n), np.empty((n, n)), np.empty((n, nv))
    work = workspace(n, nv)
    loglik, singular = 0.0, 0
    for k in range(N):
        draw(m_pred[k], U_pred[k], eta, X)
        for i in range(2 * n + 1):
            output(X[i], u[k], p, Y[i])
        split(Y, eta, centre, y_hat, D)
        for i in range(ny):
            innovation[k, i] = y[k, i] - y_hat[i]
            if not math.isfinite(innovation[k, i]) and math.isfinite(y[k, i]):
                return NOT_FINITE, k, math.nan, singular
            for j in range(ny):
                S[k, i, j] = 0.0
                for r in range(ny):
                    S[k, i, j] += UR[r, i] * UR[r, j]
                for r in range(2 * n):
                    S[k, i, j] += D[r, i] * D[r, j]
        added = correct(m_pred[k], U_pred[k], D, innovation[k], UR, m_filt[k], U_filt[k], W, e)
        if not math.isfinite(added):
            return SINGULAR_INNOVATION if math.isnan(added) else NOT_FINITE, k, math.nan, singular
        loglik += added
        for i in range(n):
            if not math.isfinite(m_filt[k, i]) or not math.isfinite(U_filt[k, i, i]):
                return NOT_FINITE, k, math.nan, singular
        if k < N - 1:
            draw(m_filt[k], U_filt[k], eta, X)
            propagate(scheme, drift_jacobian, X, u[k], dt[k], p, UQ, x_next, F, G, values, work)
            rank = joint(
                values, UQ, eta, centre, U_filt[k], m_pred[k + 1], U_pred[k + 1], gain[k], C[k],
                mean, rows, W_pred, pivot_column,
            )  # fmt: skip
            singular += 1 if rank < n else 0
    return OK, N, loglik, singular

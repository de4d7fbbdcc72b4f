"""One compiled loop of the sensitivity-based adaptive square-root unscented Kalman filter.

riva2017_sensitivity_asrukf, Tables 1 and 2. A sample is taken in thus: time update over the interval before it, with
the theta of the sample before; correction; gate; theta. The first sample has no time update. Sigma points are redrawn
before the correction. Unknowns theta are variances of Q first, then parameters of the model.
"""

from __future__ import annotations

import math

from numba import types

from noiseid_cli.estimators.adaptive_workspace import HANDLE
from noiseid_cli.estimators.excitation import excitation
from noiseid_cli.estimators.rpem import adapt
from noiseid_cli.filters.ekf import NOT_FINITE, OK, SINGULAR_INNOVATION
from noiseid_cli.filters.factors import factor_derivative
from noiseid_cli.filters.sigma_points import draw, weighted_mean
from noiseid_cli.filters.sigma_sensitivity import condition_derivative, half_moment
from noiseid_cli.filters.sigma_steps import (
    INDEFINITE_PREDICTION,
    SINGULAR_STATE,
    condition,
    keep_observed,
    spread,
)
from noiseid_cli.models.arrays import copy, copy_matrix
from noiseid_cli.models.discretisation import transition
from noiseid_cli.models.handle import borrowed, workspace_of
from noiseid_cli.models.jit import allocating, kernel, routine
from noiseid_cli.models.schemes import DENSITY
from noiseid_cli.models.signatures import matrix, vector


@allocating
def _predict(handle, u, dt):  # type: ignore[no-untyped-def]
    """Time update of mean, factor and sensitivities (Table 1); returns a code."""
    scheme, drift_jacobian, gain_varies = handle.scheme, handle.drift_jacobian, handle.gain_varies
    s = workspace_of(handle)
    n, nv, unknowns, nq = s.x.shape[0], s.UQ.shape[0], s.theta.shape[0], s.free.shape[0]
    outer, cov0, p, free = s.weights[1], s.weights[2], s.p, s.free
    for i in range(nq):
        s.UQ[free[i], free[i]] = math.sqrt(s.theta[i])
    _draw(handle)
    for i in range(2 * n + 1):
        copy(s.X[i], s.z)
        transition(scheme, drift_jacobian, s.z, u, dt, p, s.z_next, s.F, s.Gz, s.work)
        copy(s.z_next[:n], s.X_next[i])
        for j in range(unknowns):
            _push(s.F, s.dX[j, i], j - nq, s.dX_next[j, i])
        if i == 0:
            copy_matrix(s.Gz[:n], s.G)
            for j in range(unknowns):
                _push(s.F, s.open_loop[j], j - nq, s.d)
                copy(s.d[:n], s.open_loop[j])
    if gain_varies:
        copy(s.z, s.gain_z)
        copy(s.x, s.gain_z)
        transition(scheme, handle.gain_jacobian, s.gain_z, u, dt, p, s.gain_next, s.gain_F, s.gain_G, s.gain_work)
    for r in range(nv):
        for c in range(n):
            s.noise[r, c] = 0.0
            for a in range(r, nv):
                s.noise[r, c] += s.UQ[r, a] * s.G[c, a]
    for r in range(nv):
        for c in range(n):
            s.QG[r, c] = 0.0
            for a in range(r + 1):
                s.QG[r, c] += s.UQ[a, r] * s.noise[a, c]
    weighted_mean(s.X_next, outer, s.x)
    if not spread(s.X_next, n, s.x, outer, cov0, s.noise, s.stack, s.w, s.d, s.U):
        return INDEFINITE_PREDICTION
    if not _regular(s.U):
        return SINGULAR_STATE
    for j in range(unknowns):
        if gain_varies:
            _gain_derivative(handle, j - nq, j, 1.0 / math.sqrt(dt) if scheme >= DENSITY else 1.0)
        weighted_mean(s.dX_next[j], outer, s.dx[j])
        half_moment(s.X_next, s.x, s.dX_next[j], s.dx[j], n, outer, cov0, s.T)
        for a in range(n):
            for b in range(n):
                if gain_varies:
                    for r in range(nv):
                        s.T[a, b] += s.dG[a, r] * s.QG[r, b]
                if j < nq:
                    s.T[a, b] += 0.5 * s.G[a, free[j]] * s.G[b, free[j]]
        for a in range(n):
            for b in range(n):
                s.dP[j, a, b] = s.T[a, b] + s.T[b, a]
        factor_derivative(s.U, s.dP[j], s.dU[j], s.A)
    return OK


@allocating
def _draw(handle):  # type: ignore[no-untyped-def]
    """Sigma points s.X and their derivatives s.dX; the parameters of now into the stacked state s.z."""
    s = workspace_of(handle)
    n, nq, eta = s.x.shape[0], s.free.shape[0], s.weights[0]
    for i in range(nq, s.theta.shape[0]):
        s.z[n + i - nq] = s.theta[i]
    draw(s.x, s.U, eta, s.X)
    for j in range(s.theta.shape[0]):
        # The points are linear in mean and factor: their derivatives are the points of the derivatives.
        draw(s.dx[j], s.dU[j], eta, s.dX[j])


@routine
def _push(F, dx, parameter, out):  # type: ignore[no-untyped-def]
    """f_x dx + f_theta: F is the stacked model's, ``parameter`` negative for a variance."""
    n = dx.shape[0]
    for c in range(n):
        total = F[c, n + parameter] if parameter >= 0 else 0.0
        for r in range(n):
            total += F[c, r] * dx[r]
        out[c] = total


@allocating
def _gain_derivative(handle, parameter, j, scale):  # type: ignore[no-untyped-def]
    """s.dG = dF2/dx dx_j + dF2/dtheta_j; at the filtered mean, whose derivative is that of the central point."""
    s = workspace_of(handle)
    n, nv = s.G.shape
    first = s.z.shape[0]
    for a in range(n):
        for r in range(nv):
            row = first + a * nv + r
            total = s.gain_F[row, n + parameter] if parameter >= 0 else 0.0
            for i in range(n):
                total += s.gain_F[row, i] * s.dX[j, 0, i]
            s.dG[a, r] = scale * total


@routine
def _regular(U):  # type: ignore[no-untyped-def]
    """Whether every diagonal entry is above zero."""
    smallest = U[0, 0]
    for i in range(1, U.shape[0]):
        smallest = min(smallest, U[i, i])
    return smallest > 0.0


@allocating
def _correct(handle, u, y):  # type: ignore[no-untyped-def]
    """Correction of mean, factor and sensitivities (Table 2, to (d)); s.psi. Returns (code, loglik, observed)."""
    output_jacobian, s = handle.output_jacobian, workspace_of(handle)
    n, ny, unknowns, nq = s.x.shape[0], y.shape[0], s.theta.shape[0], s.free.shape[0]
    eta, outer, cov0 = s.weights[0], s.weights[1], s.weights[2]
    _draw(handle)
    for i in range(2 * n + 1):
        copy(s.X[i], s.z)
        output_jacobian(s.z, u, s.p, s.Y[i], s.H)
        for j in range(unknowns):
            for b in range(ny):
                total = s.H[b, n + j - nq] if j >= nq else 0.0
                for c in range(n):
                    total += s.H[b, c] * s.dX[j, i, c]
                s.dY[j, i, b] = total
    q = keep_observed(y, s.Y, s.UR, s.observed, s.UR_seen)
    weighted_mean(s.Y, outer, s.y_hat)
    for b in range(q):
        s.e[b] = y[s.observed[b]] - s.y_hat[b]
    for j in range(unknowns):
        for i in range(2 * n + 1):
            for b in range(q):
                s.dY[j, i, b] = s.dY[j, i, s.observed[b]]
        weighted_mean(s.dY[j], outer, s.dy[j])
        for b in range(q):
            s.psi[b, j] = s.dy[j, b]
    code, gain, failed = condition(
        s.x, s.U, s.Y, q, s.y_hat, s.e, s.UR_seen, eta, outer, cov0,
        s.x_new, s.U_new, s.Uyy, s.B, s.K, s.stack, s.w, s.d,
    )  # fmt: skip
    s.counts[1] += failed
    if code != OK or q == 0:
        return code, gain, q
    if not _regular(s.U_new):
        return SINGULAR_STATE, gain, q
    for j in range(unknowns):
        condition_derivative(
            s.U, s.dU[j], s.dP[j], s.Y, s.y_hat, s.dY[j], s.dy[j], q, s.e, s.Uyy, s.K, eta, outer, cov0,
            s.U_new, s.dx[j], s.T, s.dK, s.A,
        )  # fmt: skip
    copy(s.x_new, s.x)
    copy_matrix(s.U_new, s.U)
    return OK, gain, q


@allocating
def _gate_and_adapt(handle, q):  # type: ignore[no-untyped-def]
    """Excitation, gate (eq. 9), theta (eq. 7), projections; returns a code."""
    window, s = handle.window, workspace_of(handle)
    unknowns, nq, lower, upper = s.theta.shape[0], s.free.shape[0], s.lower, s.upper
    excitation(s.dx, s.counts[0], window, s.peaks[0], s.peak_steps[0], s.peak_ends[0], s.excited)
    excitation(s.open_loop, s.counts[0], window, s.peaks[1], s.peak_steps[1], s.peak_ends[1], s.excited_open)
    s.counts[0] += 1
    for j in range(unknowns):
        s.gate[j] = 1.0 if j < nq or s.excited[j] > s.thresholds[j] else 0.0
    if q > 0 and not adapt(
        s.theta, s.UT, s.UD, s.psi, s.e, s.observed, q, s.weights[3], s.gate, s.rpem_A, s.rpem_L, s.rpem_S, s.stack, s.w
    ):
        return SINGULAR_INNOVATION
    for j in range(unknowns):
        if s.theta[j] < lower[j] or s.theta[j] > upper[j]:
            s.theta[j] = min(max(s.theta[j], lower[j]), upper[j])
            s.counts[2 + j] += 1
        if not (math.isfinite(s.theta[j]) and math.isfinite(s.UT[j, j])):
            return NOT_FINITE
    for i in range(s.x.shape[0]):
        if not (math.isfinite(s.x[i]) and math.isfinite(s.U[i, i])):
            return NOT_FINITE
    return OK


@allocating
def _write(handle, row):  # type: ignore[no-untyped-def]
    """One row: x, its standard deviations, theta, its standard deviations, both excitations, gate."""
    s = workspace_of(handle)
    n, p = s.x.shape[0], s.theta.shape[0]
    for c in range(n):
        row[c] = s.x[c]
    for c in range(p):
        row[2 * n + c] = s.theta[c]
        row[2 * n + 2 * p + c] = s.excited[c]
        row[2 * n + 3 * p + c] = s.excited_open[c]
        row[2 * n + 4 * p + c] = s.gate[c]
    for U, begin in ((s.U, n), (s.UT, 2 * n + p)):
        for c in range(U.shape[0]):
            total = 0.0
            for r in range(c + 1):
                total += U[r, c] * U[r, c]
            row[begin + c] = math.sqrt(total)


@kernel(
    types.Tuple((types.int64, types.int64, types.float64))(
        HANDLE, types.boolean, vector, matrix, matrix, types.int64, matrix,
    ),
    allocates=True,
)  # fmt: skip
def run(handle, first, dt, u, y, stride, rows):  # type: ignore[no-untyped-def]
    """Take in the samples of y; nothing is allocated.

    Args:
        handle: see ``adaptive_workspace.prepare``.
        first: the first sample of y is the first of its test.
        dt: (N,) interval before each sample; u: (N, nu); y: (N, ny), NaN where missing.
        stride: rows are written at samples 0, stride, 2 stride, ...
        rows: (ceil(N / stride), 2 n + 5 p), written, see ``_write``.

    Returns:
        (code, samples taken in, log-likelihood of the innovations).
    """
    u_before = workspace_of(handle).u_before
    dt, u, y, rows = borrowed((dt, u, y, rows))
    loglik = 0.0
    for k in range(y.shape[0]):
        if not (first and k == 0):
            code = _predict(handle, u_before, dt[k])
            if code != OK:
                return code, k, loglik
        code, gain, q = _correct(handle, u[k], y[k])
        if code != OK:
            return code, k, loglik
        loglik += gain
        code = _gate_and_adapt(handle, q)
        if code != OK:
            return code, k, loglik
        copy(u[k], u_before)
        if k % stride == 0:
            _write(handle, rows[k // stride])
    return OK, y.shape[0], loglik

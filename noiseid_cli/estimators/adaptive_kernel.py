"""One compiled loop of the sensitivity-based adaptive square-root unscented Kalman filter.

riva2017_sensitivity_asrukf, Tables 1 and 2. A sample is taken in thus: time update over the interval before it, with
the theta of the sample before; correction; gate; theta. The first sample has no time update. Sigma points are redrawn
before the correction. Unknowns theta are variances of Q first, then parameters of the model.
"""

# ruff: noqa: N815 - fields carry the paper's letters
from __future__ import annotations

import math
from typing import NamedTuple

from numba import types

from noiseid_cli.estimators.excitation import excitation
from noiseid_cli.estimators.rpem import adapt
from noiseid_cli.filters.ekf import NOT_FINITE, OK, SINGULAR_INNOVATION, cube
from noiseid_cli.filters.factors import factor_derivative
from noiseid_cli.filters.sigma_points import draw, weighted_mean
from noiseid_cli.filters.sigma_sensitivity import condition_derivative, draw_derivative, half_moment
from noiseid_cli.filters.sigma_steps import (
    INDEFINITE_PREDICTION,
    SINGULAR_STATE,
    condition,
    keep_observed,
    spread,
)
from noiseid_cli.models.discretisation import DENSITY, transition
from noiseid_cli.models.jit import kernel, routine
from noiseid_cli.models.recording import Array
from noiseid_cli.models.signatures import DriftJacobian, OutputJacobian, matrix, vector


class Workspace(NamedTuple):
    """All that the filter keeps from sample to sample, and its scratch.

    n states, nv noises, ny outputs, p unknowns, of which the last nz - n are parameters. Kept: x, U,
    their derivatives dx (p, n), dU (p, n, n), dP; theta, the factors UT of Theta and UD of Delta; the open-loop
    sensitivity (p, n); the monitor's deques, a posteriori first and open-loop second; counts.
    """

    x: Array
    U: Array
    dx: Array
    dU: Array
    dP: Array
    theta: Array
    UT: Array
    UD: Array
    open_loop: Array
    gate: Array  # (p,) 1 open, 0 closed
    excited: Array  # (p,) what the gate decided on
    excited_open: Array
    peaks: Array  # (2, p, n, c)
    peak_steps: Array
    peak_ends: Array  # (2, p, n, 2)
    counts: Array  # samples, corrections stacked, then (p,) projections
    UQ: Array
    x_new: Array
    U_new: Array
    X: Array
    dX: Array
    X_next: Array
    dX_next: Array
    Y: Array
    dY: Array
    y_hat: Array
    dy: Array  # (p, ny)
    psi: Array  # (ny, p)
    e: Array
    UR_seen: Array
    observed: Array
    Uyy: Array
    Pxy: Array
    K: Array
    dK: Array
    z: Array
    z_next: Array
    F: Array
    Gz: Array
    H: Array
    G: Array
    dG: Array
    noise: Array
    QG: Array
    T: Array
    A: Array
    gain_z: Array
    gain_next: Array
    gain_F: Array
    gain_G: Array
    rpem_A: Array
    rpem_L: Array
    rpem_S: Array
    W: Array
    w: Array
    d: Array
    work: Array
    gain_work: Array


_KINDS = {
    vector: "x theta gate excited excited_open x_new y_hat e z z_next gain_z gain_next w d work gain_work",
    cube: "dU dP dX dX_next dY dK",
    types.int64[::1]: "counts observed",
    types.float64[:, :, :, ::1]: "peaks",
    types.int64[:, :, :, ::1]: "peak_steps peak_ends",
}
_KIND = {name: kind for kind, names in _KINDS.items() for name in names.split()}  # all others are matrices
_WORKSPACE = types.NamedTuple(tuple(_KIND.get(name, matrix) for name in Workspace._fields), Workspace)


@routine
def _predict(scheme, drift_jacobian, gain_varies, gain_jacobian, p, weights, free, s, u, dt):  # type: ignore[no-untyped-def]
    """Time update of mean, factor and sensitivities (Table 1); returns a code."""
    n, nv, unknowns, nq = s.x.shape[0], s.UQ.shape[0], s.theta.shape[0], free.shape[0]
    eta, outer, cov0 = weights[0], weights[1], weights[2]
    for i in range(nq):
        s.UQ[free[i], free[i]] = math.sqrt(s.theta[i])
    for i in range(nq, unknowns):
        s.z[n + i - nq] = s.theta[i]
    draw(s.x, s.U, eta, s.X)
    for j in range(unknowns):
        draw_derivative(s.dx[j], s.dU[j], eta, s.dX[j])
    for i in range(2 * n + 1):
        s.z[:n] = s.X[i]
        transition(scheme, drift_jacobian, s.z, u, dt, p, s.z_next, s.F, s.Gz, s.work)
        s.X_next[i] = s.z_next[:n]
        for j in range(unknowns):
            _push(s.F, s.dX[j, i], j - nq, s.dX_next[j, i])
        if i == 0:
            s.G[:, :] = s.Gz[:n]
            for j in range(unknowns):
                _push(s.F, s.open_loop[j], j - nq, s.d)
                s.open_loop[j] = s.d[:n]
    if gain_varies:
        s.gain_z[:n] = s.x
        s.gain_z[n : s.z.shape[0]] = s.z[n:]
        transition(scheme, gain_jacobian, s.gain_z, u, dt, p, s.gain_next, s.gain_F, s.gain_G, s.gain_work)
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
    if not spread(s.X_next, n, s.x, outer, cov0, s.noise, s.W, s.w, s.d, s.U):
        return INDEFINITE_PREDICTION
    if not _regular(s.U):
        return SINGULAR_STATE
    for j in range(unknowns):
        if gain_varies:
            _gain_derivative(s, j - nq, j, 1.0 / math.sqrt(dt) if scheme >= DENSITY else 1.0)
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


@routine
def _push(F, dx, parameter, out):  # type: ignore[no-untyped-def]
    """f_x dx + f_theta: F is the stacked model's, ``parameter`` negative for a variance."""
    n = dx.shape[0]
    for c in range(n):
        total = F[c, n + parameter] if parameter >= 0 else 0.0
        for r in range(n):
            total += F[c, r] * dx[r]
        out[c] = total


@routine
def _gain_derivative(s, parameter, j, scale):  # type: ignore[no-untyped-def]
    """s.dG = dF2/dx dx_j + dF2/dtheta_j; at the filtered mean, whose derivative is that of the central point."""
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


@routine
def _correct(output_jacobian, p, weights, UR, nq, s, u, y):  # type: ignore[no-untyped-def]
    """Correction of mean, factor and sensitivities (Table 2, to (d)); s.psi. Returns (code, loglik, observed)."""
    n, ny, unknowns = s.x.shape[0], y.shape[0], s.theta.shape[0]
    eta, outer, cov0 = weights[0], weights[1], weights[2]
    for i in range(nq, unknowns):
        s.z[n + i - nq] = s.theta[i]
    draw(s.x, s.U, eta, s.X)
    for j in range(unknowns):
        draw_derivative(s.dx[j], s.dU[j], eta, s.dX[j])
    for i in range(2 * n + 1):
        s.z[:n] = s.X[i]
        output_jacobian(s.z, u, p, s.Y[i], s.H)
        for j in range(unknowns):
            for b in range(ny):
                total = s.H[b, n + j - nq] if j >= nq else 0.0
                for c in range(n):
                    total += s.H[b, c] * s.dX[j, i, c]
                s.dY[j, i, b] = total
    q = keep_observed(y, s.Y, UR, s.observed, s.UR_seen)
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
        s.x_new, s.U_new, s.Uyy, s.Pxy, s.K, s.W, s.w, s.d,
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
    s.x[:], s.U[:, :] = s.x_new, s.U_new
    return OK, gain, q


@routine
def _gate_and_adapt(forgetting, nq, lower, upper, thresholds, window, s, q):  # type: ignore[no-untyped-def]
    """Excitation, gate (eq. 9), theta (eq. 7), projections; returns a code."""
    unknowns = s.theta.shape[0]
    excitation(s.dx, s.counts[0], window, s.peaks[0], s.peak_steps[0], s.peak_ends[0], s.excited)
    excitation(s.open_loop, s.counts[0], window, s.peaks[1], s.peak_steps[1], s.peak_ends[1], s.excited_open)
    s.counts[0] += 1
    for j in range(unknowns):
        s.gate[j] = 1.0 if j < nq or s.excited[j] > thresholds[j] else 0.0
    if q > 0 and not adapt(
        s.theta, s.UT, s.UD, s.psi, s.e, s.observed, q, forgetting, s.gate, s.rpem_A, s.rpem_L, s.rpem_S, s.W, s.w
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


@routine
def _write(s, x, x_std, theta, theta_std, excited, excited_open, gate):  # type: ignore[no-untyped-def]
    """One row of each series."""
    x[:], theta[:], excited[:], excited_open[:], gate[:] = s.x, s.theta, s.excited, s.excited_open, s.gate
    for U, std in ((s.U, x_std), (s.UT, theta_std)):
        for c in range(U.shape[0]):
            std[c] = 0.0
            for r in range(c + 1):
                std[c] += U[r, c] * U[r, c]
            std[c] = math.sqrt(std[c])


@kernel(
    types.Tuple((types.int64, types.int64, types.float64))(
        types.int64, DriftJacobian, types.boolean, DriftJacobian, OutputJacobian, vector, vector, matrix,
        types.int64[::1], vector, vector, vector, types.int64, _WORKSPACE, types.boolean, vector,
        vector, matrix, matrix, types.int64, matrix, matrix, matrix, matrix, matrix, matrix, matrix,
    ),
)  # fmt: skip
def run(  # type: ignore[no-untyped-def]
    scheme, drift_jacobian, gain_varies, gain_jacobian, output_jacobian, p, weights, UR,
    free, lower, upper, thresholds, window, s, first, u_before,
    dt, u, y, stride, x, x_std, theta, theta_std, excited, excited_open, gate,
):  # fmt: skip
    """Take in the samples of y; nothing is allocated.

    Args:
        scheme, drift_jacobian, output_jacobian, p: the stacked model's, see ``models.stacked``.
        gain_varies, gain_jacobian: whether F2 depends on x or theta, and the model with gains as states.
        weights: eta, outer, cov0, forgetting.
        UR: (ny, ny) factor of R.
        free: index of each free variance of Q.
        lower, upper, thresholds: (p,).
        window: see ``excitation``.
        s: the workspace.
        first: the first sample of y is the first of its test.
        u_before: (nu,) input before the first sample.
        dt: (N,) interval before each sample; u: (N, nu); y: (N, ny), NaN where missing.
        stride: rows of the series are written at samples 0, stride, 2 stride, ...
        x, x_std, theta, theta_std, excited, excited_open, gate: series, written.

    Returns:
        (code, samples taken in, log-likelihood of the innovations).
    """
    loglik, nq = 0.0, free.shape[0]
    for k in range(y.shape[0]):
        if not (first and k == 0):
            before = u_before if k == 0 else u[k - 1]
            code = _predict(
                scheme, drift_jacobian, gain_varies, gain_jacobian, p, weights, free, s, before, dt[k]
            )  # fmt: skip
            if code != OK:
                return code, k, loglik
        code, gain, q = _correct(output_jacobian, p, weights, UR, nq, s, u[k], y[k])
        if code != OK:
            return code, k, loglik
        loglik += gain
        code = _gate_and_adapt(weights[3], nq, lower, upper, thresholds, window, s, q)
        if code != OK:
            return code, k, loglik
        if k % stride == 0:
            i = k // stride
            _write(s, x[i], x_std[i], theta[i], theta_std[i], excited[i], excited_open[i], gate[i])
    return OK, y.shape[0], loglik

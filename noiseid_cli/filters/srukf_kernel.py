"""The compiled loop of the square-root unscented filter, and the workspace that it keeps between samples."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import types

from noiseid_cli.filters.ekf import NOT_FINITE, OK, cube
from noiseid_cli.filters.gram_schmidt import width
from noiseid_cli.filters.sigma_points import draw, weighted_mean
from noiseid_cli.filters.sigma_steps import INDEFINITE_PREDICTION, condition, keep_observed, spread
from noiseid_cli.models.arrays import copy, copy_matrix
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.discretisation import advance_all, transition, workspace
from noiseid_cli.models.handle import borrowed, handle_type, new, workspace_of
from noiseid_cli.models.jit import allocating, kernel
from noiseid_cli.models.recording import Array
from noiseid_cli.models.schemes import DENSITY, EXACT
from noiseid_cli.models.signatures import Drift, DriftJacobian, Output, matrix, vector


class Workspace(NamedTuple):
    """What the filter reads, its state between samples, and its scratch; see ``new_workspace`` for the shapes."""

    p: Array
    weights: Array  # eta, outer, cov0
    UQ: Array
    UR: Array
    u_before: Array  # (nu,) input before the next sample
    x: Array
    U: Array
    sd: Array  # (n,) standard deviations of x
    x_new: Array
    U_new: Array
    X: Array
    X_next: Array
    Y: Array
    y_hat: Array
    e: Array
    UR_seen: Array
    noise: Array
    F: Array
    G: Array
    Uyy: Array
    B: Array
    K: Array
    A: Array
    w: Array
    d: Array
    v: Array
    work: Array
    lower: Array
    upper: Array
    observed: Array
    counts: Array  # corrections stacked, then (nx,) projections on bounds


_WORKSPACE = types.NamedTuple(
    (vector, vector, matrix, matrix, vector,
     vector, matrix, vector, vector, matrix, matrix, matrix, matrix, vector, vector, matrix, matrix, matrix, matrix,
     matrix, matrix, matrix, matrix, vector, vector, vector, vector, vector, vector,
     types.int64[::1], types.int64[::1]),
    Workspace,
)  # fmt: skip

HANDLE = handle_type(scheme=types.int64, drift=Drift, drift_jacobian=DriftJacobian, output=Output, workspace=_WORKSPACE)


def new_workspace(model: CompiledModel, own: Array) -> Workspace:
    """Empty state and scratch; ``own`` are the noise rows that do not depend on the state."""
    n, nv, ny = model.nx, model.nv, model.ny
    wide = max(n, ny)
    noise = np.zeros((nv + len(own), n))
    noise[nv:] = own
    e = np.empty
    return Workspace(
        e(len(model.parameters)), e(3), e((nv, nv)), e((ny, ny)), np.zeros(model.nu),
        e(n), e((n, n)), e(n), e(n), e((n, n)), e((2 * n + 1, n)), e((2 * n + 1, n)), e((2 * n + 1, ny)), e(ny), e(ny),
        e((ny, ny)), noise, e((n, n)), e((n, nv)), e((ny, ny)), e((n, ny)), e((n, ny)),
        e((wide, width(2 * n + 1 + max(ny, nv + len(own))))), e(wide), e(wide), np.zeros(nv), workspace(n, nv),
        np.full(n, -np.inf), np.full(n, np.inf), np.empty(ny, dtype=np.int64), np.zeros(1 + n, dtype=np.int64),
    )  # fmt: skip


@allocating
def _predict(handle, u, dt):  # type: ignore[no-untyped-def]
    """Time update of x and U over an interval (riva2017_sensitivity_asrukf, Table 1)."""
    scheme, drift, drift_jacobian, s = handle.scheme, handle.drift, handle.drift_jacobian, workspace_of(handle)
    n, nv = s.G.shape
    eta, outer, cov0, p = s.weights[0], s.weights[1], s.weights[2], s.p
    draw(s.x, s.U, eta, s.X)
    exact = scheme == EXACT or scheme == EXACT + DENSITY
    if exact:
        for i in range(1, 2 * n + 1):
            transition(scheme, drift_jacobian, s.X[i], u, dt, p, s.X_next[i], s.F, s.G, s.work)
    else:
        advance_all(scheme, drift, s.X[1:], u, s.v, dt, p, s.X_next[1:], s.work)
    transition(scheme, drift_jacobian, s.x, u, dt, p, s.X_next[0], s.F, s.G, s.work)
    for r in range(nv):
        for c in range(n):
            total = 0.0
            for a in range(r, nv):
                total += s.UQ[r, a] * s.G[c, a]
            s.noise[r, c] = total
    weighted_mean(s.X_next, outer, s.x)
    return OK if spread(s.X_next, n, s.x, outer, cov0, s.noise, s.A, s.w, s.d, s.U) else INDEFINITE_PREDICTION


@kernel(HANDLE(types.int64, Drift, DriftJacobian, Output, _WORKSPACE), allocates=True)
def prepare(scheme, drift, drift_jacobian, output, state):  # type: ignore[no-untyped-def]
    """The handle for ``run``."""
    handle = new(HANDLE)
    handle.scheme = scheme
    handle.drift = drift
    handle.drift_jacobian = drift_jacobian
    handle.output = output
    handle.workspace = state
    return handle


@kernel(
    types.Tuple((types.int64, types.int64, types.float64))(
        HANDLE, types.boolean, vector, matrix, matrix, matrix, cube, matrix, cube, matrix,
    ),
    allocates=True,
)  # fmt: skip
def run(handle, first, dt, u, y, m_pred, U_pred, m_filt, U_filt, innovation):  # type: ignore[no-untyped-def]
    """Take in the samples of y; the arrays from m_pred on are written. Returns (code, samples, loglik)."""
    output, s = handle.output, workspace_of(handle)
    dt, u, y, m_pred, U_pred, m_filt, U_filt, innovation = borrowed(
        (dt, u, y, m_pred, U_pred, m_filt, U_filt, innovation)
    )
    weights = s.weights
    n = s.x.shape[0]
    loglik = 0.0
    for k in range(y.shape[0]):
        if not (first and k == 0):
            code = _predict(handle, s.u_before, dt[k])
            if code != OK:
                return code, k, loglik
        copy(s.x, m_pred[k])
        copy_matrix(s.U, U_pred[k])
        draw(s.x, s.U, weights[0], s.X)
        for i in range(2 * n + 1):
            output(s.X[i], u[k], s.p, s.Y[i])
        weighted_mean(s.Y, weights[1], s.y_hat)
        for b in range(y.shape[1]):
            innovation[k, b] = y[k, b] - s.y_hat[b]
        q = keep_observed(y[k], s.Y, s.UR, s.observed, s.UR_seen)
        for b in range(q):
            s.y_hat[b] = s.y_hat[s.observed[b]]
            s.e[b] = innovation[k, s.observed[b]]
        code, gain, failed = condition(
            s.x, s.U, s.Y, q, s.y_hat, s.e, s.UR_seen, weights[0], weights[1], weights[2],
            s.x_new, s.U_new, s.Uyy, s.B, s.K, s.A, s.w, s.d,
        )  # fmt: skip
        s.counts[0] += failed
        if code != OK:
            return code, k, loglik
        loglik += gain
        copy(s.x_new, s.x)
        copy_matrix(s.U_new, s.U)
        for i in range(n):
            if s.x[i] < s.lower[i] or s.x[i] > s.upper[i]:
                s.x[i] = min(max(s.x[i], s.lower[i]), s.upper[i])
                s.counts[1 + i] += 1
            if not math.isfinite(s.x[i]) or not math.isfinite(s.U[i, i]):
                return NOT_FINITE, k, loglik
        copy(s.x, m_filt[k])
        copy_matrix(s.U, U_filt[k])
        copy(u[k], s.u_before)
    for c in range(n):
        total = 0.0
        for r in range(c + 1):
            total += s.U[r, c] * s.U[r, c]
        s.sd[c] = math.sqrt(total)
    return OK, y.shape[0], loglik

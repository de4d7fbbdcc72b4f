"""From continuous equations to x_next = F1(x, u) + F2(x) v, with exact Jacobians of the discrete map.

Input and noise are held over the interval. The noise is per sample, v being the held value, unless the scheme says
that it is a density: then v has the unit of the noise per root hertz, and its held value is v / sqrt(dt).
"""

from __future__ import annotations

import math

import numpy as np

from noiseid_cli.models.arrays import copy_matrix
from noiseid_cli.models.exponential import held_exponential
from noiseid_cli.models.jit import allocating, routine
from noiseid_cli.models.schemes import DENSITY, DISCRETE, EULER, EXACT


@routine
def transition(scheme, jacobian, x, u, dt, p, x_next, F, G, work):  # type: ignore[no-untyped-def]
    """One step with its Jacobians: x_next = F1(x, u), F = dF1/dx, G = F2 = dx_next/dv at v = 0.

    Args:
        scheme: DISCRETE, EULER, RK4 or EXACT, with DENSITY added where v is a density.
        jacobian: the model's drift_jacobian.
        x, u, p: state (n,), input (nu,), parameters (np,).
        dt: interval, s.
        x_next, F, G: outputs, (n,), (n, n), (n, nv).
        work: ``workspace(n, nv)``; EXACT keeps its last exponential there, for the next step like this one.
    """
    n, nv = G.shape
    kind = scheme - DENSITY if scheme >= DENSITY else scheme
    if kind == DISCRETE:
        jacobian(x, u, p, x_next, F, G)
    elif kind == EULER:
        jacobian(x, u, p, x_next, F, G)
        for i in range(n):
            x_next[i] = x[i] + dt * x_next[i]
            for j in range(n):
                F[i, j] *= dt
            F[i, i] += 1.0
            for j in range(nv):
                G[i, j] *= dt
    elif kind == EXACT:
        _exact(jacobian, x, u, dt, p, x_next, F, G, work)
    else:
        _runge_kutta(jacobian, x, u, dt, p, x_next, F, G, work)
    if scheme >= DENSITY:
        scale = 1.0 / math.sqrt(dt)
        for i in range(n):
            for j in range(nv):
                G[i, j] *= scale


@routine
def _exact(jacobian, x, u, dt, p, x_next, F, G, work):  # type: ignore[no-untyped-def]
    """Exact step of x' = A x + B v + c: F = exp(A dt), G = Psi B, x_next = x + Psi f with f = A x + c."""
    n, nv = G.shape
    nn = n * n
    A = work[1 : 1 + nn].reshape(n, n)
    Phi = work[1 + nn : 1 + 2 * nn].reshape(n, n)
    Psi = work[1 + 2 * nn : 1 + 3 * nn].reshape(n, n)
    f = work[1 + 3 * nn : 1 + 3 * nn + n]
    B = work[1 + 3 * nn + n : 1 + 3 * nn + n + n * nv].reshape(n, nv)
    jacobian(x, u, p, f, F, B)
    known = work[0] == dt
    for i in range(n):
        for j in range(n):
            known = known and A[i, j] == F[i, j]
    if not known:
        copy_matrix(F, A)
        held_exponential(A, dt, Phi, Psi, work[1 + 3 * nn + n + n * nv :])
        work[0] = dt
    for i in range(n):
        x_next[i] = x[i]
        for j in range(n):
            F[i, j] = Phi[i, j]
            x_next[i] += Psi[i, j] * f[j]
        for c in range(nv):
            G[i, c] = 0.0
            for j in range(n):
                G[i, c] += Psi[i, j] * B[j, c]


@routine
def _runge_kutta(jacobian, x, u, dt, p, x_next, F, G, work):  # type: ignore[no-untyped-def]
    """Classical fourth-order step; its Jacobians follow by the chain rule through the four stages.

    With K = dk/d(x, v) of a stage and c the stage's weight, stage s has
    K_s = [A_s (I + c dt K_x), A_s c dt K_v + B_s], A_s and B_s taken at the stage's own state.
    """
    n, nv = G.shape
    columns = n + nv + 1
    stage = work[:n]
    k = work[n : 2 * n]
    A = work[2 * n : 2 * n + n * n].reshape(n, n)
    B = work[2 * n + n * n : 2 * n + n * n + n * nv].reshape(n, nv)
    stages = work[2 * n + n * n + n * nv :][: 3 * n * columns].reshape(3, n, columns)
    K, K_new, total = stages[0], stages[1], stages[2]
    K[:] = 0.0
    total[:] = 0.0
    k[:] = 0.0
    for s in range(4):
        c = 0.0 if s == 0 else (1.0 if s == 3 else 0.5)
        w = dt / 6.0 if s in (0, 3) else dt / 3.0
        for i in range(n):
            stage[i] = x[i] + c * dt * k[i]
        jacobian(stage, u, p, k, A, B)
        for i in range(n):
            for j in range(n + nv):
                value = A[i, j] if j < n else B[i, j - n]
                for r in range(n):
                    value += A[i, r] * c * dt * K[r, j]
                K_new[i, j] = value
            K_new[i, n + nv] = k[i]
        for i in range(n):
            for j in range(columns):
                K[i, j] = K_new[i, j]
                total[i, j] += w * K_new[i, j]
    for i in range(n):
        x_next[i] = x[i] + total[i, n + nv]
        for j in range(n):
            F[i, j] = total[i, j]
        F[i, i] += 1.0
        for j in range(nv):
            G[i, j] = total[i, n + j]


@routine
def advance(scheme, drift, x, u, v, dt, p, x_next, work):  # type: ignore[no-untyped-def]
    """One step without Jacobians: x_next = F1(x, u) for v = 0.

    Args:
        scheme: DISCRETE, EULER or RK4; DENSITY changes nothing here. EXACT needs its Jacobian: see ``transition``.
        drift: the model's drift.
        x, u, v, p: state (n,), input (nu,), noise held over the interval (nv,), parameters (np,).
        dt: interval, s.
        x_next: output (n,).
        work: scratch (2n,); read for RK4 only.
    """
    n = x.size
    kind = scheme - DENSITY if scheme >= DENSITY else scheme
    drift(x, u, v, p, x_next)
    if kind == DISCRETE:
        return
    if kind == EULER:
        for i in range(n):
            x_next[i] = x[i] + dt * x_next[i]
        return
    stage, k = work[:n], work[n : 2 * n]
    for i in range(n):
        k[i] = x_next[i]
        x_next[i] = x[i] + dt / 6.0 * k[i]
    for s in range(1, 4):
        for i in range(n):
            stage[i] = x[i] + (dt if s == 3 else 0.5 * dt) * k[i]
        drift(stage, u, v, p, k)
        for i in range(n):
            x_next[i] += (dt / 6.0 if s == 3 else dt / 3.0) * k[i]


@routine
def advance_all(scheme, drift, X, u, v, dt, p, X_next, work):  # type: ignore[no-untyped-def]
    """``advance`` for each row of X (k, n), written to the rows of X_next.

    All rates come first: a step that waits for what a call has just written takes half as long again.
    """
    kind = scheme - DENSITY if scheme >= DENSITY else scheme
    if kind not in (DISCRETE, EULER):
        for i in range(X.shape[0]):
            advance(scheme, drift, X[i], u, v, dt, p, X_next[i], work)
        return
    for i in range(X.shape[0]):
        drift(X[i], u, v, p, X_next[i])
    if kind == EULER:
        for i in range(np.uint64(X.shape[0])):
            for c in range(np.uint64(X.shape[1])):
                X_next[i, c] = X[i, c] + dt * X_next[i, c]


@allocating
def workspace(n, nv):  # type: ignore[no-untyped-def]
    """The scratch array that ``transition`` wants; zeros, since no interval is 0 s, mean that nothing is kept yet."""
    runge_kutta = 2 * n + n * n + n * nv + 3 * n * (n + nv + 1)
    exact = 1 + 5 * n * n + 2 * n + n * nv
    return np.zeros(max(runge_kutta, exact))

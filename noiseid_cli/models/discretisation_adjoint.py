"""Reverse derivatives of one discretised step with its Jacobians: what a change of x and p does to x_next, F and G.

The step of ``models.discretisation`` is taken apart in reverse order, its stages' Jacobians through the model's own
adjoint. A caller gives the weights of x_next, F and G in a scalar and gets the derivatives of that scalar.
"""

from __future__ import annotations

import math

from noiseid_cli.models.exponential import held_exponential, held_exponential_adjoint
from noiseid_cli.models.jit import routine
from noiseid_cli.models.schemes import DENSITY, DISCRETE, EULER, EXACT, RK4

_KNOWN = (DISCRETE, EULER, RK4, EXACT)
REVERSIBLE = (*_KNOWN, *(scheme + DENSITY for scheme in _KNOWN))
"""The schemes whose steps are known here."""


@routine
def transition_adjoint(  # type: ignore[no-untyped-def]
    scheme, jacobian, adjoint, x, u, dt, p, x_bar, F_bar, G_bar, gx, gp, work
):
    """Derivatives by x and p of  x_bar . x_next + <F_bar, F> + <G_bar, G>.

    Args:
        scheme: one of ``REVERSIBLE``.
        jacobian, adjoint: the model's drift_jacobian and its adjoint.
        x, u, dt, p: where the step was taken.
        x_bar, F_bar, G_bar: weights (n,), (n, n), (n, nv); G_bar is overwritten where v is a density.
        gx, gp: written, (n,), (np,).
        work: scratch (adjoint_work_size(n, nv, np),).
    """
    n, nv = G_bar.shape
    size = n * (1 + n + nv)
    if scheme >= DENSITY:
        # G is divided by sqrt(dt) there, and so its weights are.
        scheme -= DENSITY
        for i in range(n):
            for j in range(nv):
                G_bar[i, j] /= math.sqrt(dt)
    if scheme == RK4:
        _runge_kutta_adjoint(jacobian, adjoint, x, u, dt, p, x_bar, F_bar, G_bar, gx, gp, work)
        return
    if scheme == EXACT:
        _exact_adjoint(jacobian, adjoint, x, u, dt, p, x_bar, F_bar, G_bar, gx, gp, work)
        return
    w = work[:size]
    c = dt if scheme == EULER else 1.0
    for i in range(n):
        w[i] = c * x_bar[i]
        for j in range(n):
            w[n + i * n + j] = c * F_bar[i, j]
        for j in range(nv):
            w[n + n * n + i * nv + j] = c * G_bar[i, j]
    adjoint(x, u, p, w, gx, gp)
    if scheme == EULER:
        for i in range(n):
            gx[i] += x_bar[i]


@routine
def _exact_adjoint(  # type: ignore[no-untyped-def]
    jacobian, adjoint, x, u, dt, p, x_bar, F_bar, G_bar, gx, gp, work
):
    """Reverse of x_next = x + Psi f, F = Phi, G = Psi B, with Phi and Psi from the rates' A; see ``_exact``."""
    n, nv = G_bar.shape
    nn = n * n
    size = n * (1 + n + nv)
    w = work[:size]
    f = work[size : size + n]
    at = size + n
    A = work[at : at + nn].reshape(n, n)
    Phi = work[at + nn : at + 2 * nn].reshape(n, n)
    Psi = work[at + 2 * nn : at + 3 * nn].reshape(n, n)
    A_bar = work[at + 3 * nn : at + 4 * nn].reshape(n, n)
    at += 4 * nn
    B = work[at : at + n * nv].reshape(n, nv)
    jacobian(x, u, p, f, A, B)
    held_exponential(A, dt, Phi, Psi, work[at + n * nv :])
    for i in range(n):
        w[i] = 0.0
        for r in range(n):
            w[i] += Psi[r, i] * x_bar[r]
        for c in range(nv):
            total = 0.0
            for r in range(n):
                total += Psi[r, i] * G_bar[r, c]
            w[n + nn + i * nv + c] = total
    for i in range(n):
        for j in range(n):
            Phi[i, j] = F_bar[i, j]
            total = x_bar[i] * f[j]
            for c in range(nv):
                total += G_bar[i, c] * B[j, c]
            Psi[i, j] = total
    held_exponential_adjoint(A, dt, Phi, Psi, A_bar)
    for i in range(n):
        for j in range(n):
            w[n + i * n + j] = A_bar[i, j]
    adjoint(x, u, p, w, gx, gp)
    for i in range(n):
        gx[i] += x_bar[i]


@routine
def _runge_kutta_adjoint(  # type: ignore[no-untyped-def]
    jacobian, adjoint, x, u, dt, p, x_bar, F_bar, G_bar, gx, gp, work
):
    """Reverse of the four stages K_s = A_s ([I 0] + c dt K_{s-1}) + [0 B_s], k_s; see ``_runge_kutta``.

    ``T`` holds [I 0] + c dt K_{s-1} of each stage, its last column the increment of the stage's state.
    """
    n, nv = G_bar.shape
    q = n + nv
    columns = q + 1
    size = n * (1 + n + nv)
    at = 0
    w = work[at : at + size]
    at += size
    stage = work[at : at + 4 * n].reshape(4, n)
    at += 4 * n
    k = work[at : at + n]
    at += n
    hx = work[at : at + n]
    at += n
    hp = work[at : at + p.size]
    at += p.size
    A = work[at : at + 4 * n * n].reshape(4, n, n)
    at += 4 * n * n
    B = work[at : at + n * nv].reshape(n, nv)
    at += n * nv
    T = work[at : at + 4 * n * columns].reshape(4, n, columns)
    at += 4 * n * columns
    K_bar = work[at : at + n * columns].reshape(n, columns)
    at += n * columns
    T_bar = work[at : at + n * columns].reshape(n, columns)
    for s in range(4):
        c = 0.0 if s == 0 else (1.0 if s == 3 else 0.5)
        for i in range(n):
            for j in range(q):
                # K_{s-1} = A_{s-1} T_{s-1} + [0 B_{s-1}]: A and B still hold the stage before.
                K = 0.0
                if s > 0:
                    if j >= n:
                        K = B[i, j - n]
                    for r in range(n):
                        K += A[s - 1, i, r] * T[s - 1, r, j]
                T[s, i, j] = c * dt * K + (1.0 if i == j else 0.0)
            stage[s, i] = x[i] + (c * dt * k[i] if s > 0 else 0.0)
        jacobian(stage[s], u, p, k, A[s], B)
    T_bar[:] = 0.0
    gp[:] = 0.0
    for i in range(n):
        gx[i] = x_bar[i]
    for s in range(3, -1, -1):
        # The weight of K_s: its share of the sum, and through the stage after it.
        weight = dt / 6.0 if s in (0, 3) else dt / 3.0
        after = 0.0 if s == 3 else (1.0 if s == 2 else 0.5)
        for i in range(n):
            for j in range(n):
                K_bar[i, j] = weight * F_bar[i, j] + after * dt * T_bar[i, j]
            for j in range(nv):
                K_bar[i, n + j] = weight * G_bar[i, j] + after * dt * T_bar[i, n + j]
            K_bar[i, q] = weight * x_bar[i] + after * dt * T_bar[i, q]
        for i in range(n):
            w[i] = K_bar[i, q]
            for r in range(n):
                total = 0.0
                for j in range(q):
                    total += K_bar[i, j] * T[s, r, j]
                w[n + i * n + r] = total
            for j in range(nv):
                w[n + n * n + i * nv + j] = K_bar[i, n + j]
        adjoint(stage[s], u, p, w, hx, hp)
        for r in range(n):
            for j in range(q):
                total = 0.0
                for i in range(n):
                    total += A[s, i, r] * K_bar[i, j]
                T_bar[r, j] = total
            T_bar[r, q] = hx[r]
            gx[r] += hx[r]
        for j in range(p.size):
            gp[j] += hp[j]


@routine
def adjoint_work_size(n, nv, parameters):  # type: ignore[no-untyped-def]
    """Length of the scratch array that ``transition_adjoint`` wants."""
    size = n * (1 + n + nv)
    runge_kutta = 6 * n + parameters + 4 * n * n + n * nv + 6 * n * (n + nv + 1)
    exact = 2 * n + 6 * n * n + n * nv
    return size + max(runge_kutta, exact)

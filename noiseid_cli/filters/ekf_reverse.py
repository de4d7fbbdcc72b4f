"""The extended Kalman filter run backward: the adjoints of its log-likelihood, sample by sample.

With the linearisation held fixed the recursion is that of Bryson and Frazier; the adjoints of F, G, H, F1 and h add
the rest. Derivation, with J = I - K H, a = S^-1 nu, M = 1/2 (a a' - S^-1), and X_ the derivative of the log-likelihood
by X (symmetric where X is):

    update    m_pred_ = J' m_filt_ + H' a + (through H),   P_pred_ = J' P_filt_ J + H' M H + sym(J' m_filt_ a' H)
              R_ += M + K' P_filt_ K - sym(K' m_filt_ a'),   h_ = a - K' m_filt_
              H_ = 2 M H P_pred - 2 K' P_filt_ P_filt + a (P_filt m_filt_)' - K' m_filt_ (K nu)'
    predict   m_filt_ = (through F1, F, G),  P_filt_ = F' P_pred_ F,  Q_ += G' P_pred_ G
              F_ = 2 P_pred_ F P_filt,  G_ = 2 P_pred_ G Q

The derivative of P_filt by K vanishes at the optimal K, which is why none stands there. What F, G and F1 are made of
is taken apart by ``models.discretisation_adjoint``, for every scheme.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from noiseid_cli.filters.ekf import cube
from noiseid_cli.filters.linalg import backward_solve, forward_solve, triangularise
from noiseid_cli.models.discretisation_adjoint import adjoint_work_size, transition_adjoint
from noiseid_cli.models.jit import kernel, routine
from noiseid_cli.models.signatures import Adjoint, DriftJacobian, matrix, vector
from noiseid_cli.models.vectors import EIGHT, load, plus, store, times


@routine
def _gram(U, P):  # type: ignore[no-untyped-def]
    """P = U'U of an upper triangle."""
    n = U.shape[0]
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for r in range(j + 1):
                total += U[r, i] * U[r, j]
            P[i, j] = total
            P[j, i] = total


@routine
def _sandwich(A, X, Y, out, W):  # type: ignore[no-untyped-def]
    """Write A' X Y to out, with A (r, a), X (r, s), Y (s, b); W is scratch (>= r, >= b)."""
    r, columns = np.uint64(A.shape[0]), np.uint64(A.shape[1])
    s, b = np.uint64(Y.shape[0]), np.uint64(Y.shape[1])
    one, whole = np.uint64(1), b // EIGHT * EIGHT
    for block in range(b // EIGHT):
        j = block * EIGHT
        for i in range(r):
            sums = times(X[i, 0], load(Y, 0, j))
            for c in range(one, s):
                sums = plus(sums, X[i, c], load(Y, c, j))
            store(W, i, j, sums)
        for i in range(columns):
            sums = times(A[0, i], load(W, 0, j))
            for c in range(one, r):
                sums = plus(sums, A[c, i], load(W, c, j))
            store(out, i, j, sums)
    for k in range(whole, b):
        for i in range(r):
            total = 0.0
            for c in range(s):
                total += X[i, c] * Y[c, k]
            W[i, k] = total
        for i in range(columns):
            total = 0.0
            for c in range(r):
                total += A[c, i] * W[c, k]
            out[i, k] = total


@routine
def _innovation_parts(U, H, UR, innovation, seen, Hs, Sinv, K, a, W, V, w):  # type: ignore[no-untyped-def]
    """Rows of the observed outputs: Hs (q, n), S^-1 (q, q), gain K (n, q) and a = S^-1 nu (q,). Returns q."""
    ny, n = H.shape
    q = 0
    for i in range(ny):
        if not math.isnan(innovation[i]):
            seen[q] = i
            q += 1
    for s in range(q):
        i = seen[s]
        for r in range(ny):
            W[r, s] = UR[r, i]
        for c in range(n):
            Hs[s, c] = H[i, c]
        for r in range(n):
            total = 0.0
            for c in range(r, n):
                total += U[r, c] * H[i, c]
            W[ny + r, s] = total
            V[r, s] = total
    triangularise(W, ny + n, q, q)
    # Columns of S^-1 H P = K', then of S^-1.
    for c in range(n + q):
        for s in range(q):
            if c < n:
                total = 0.0
                for r in range(c + 1):
                    total += U[r, c] * V[r, s]
            else:
                total = 1.0 if c - n == s else 0.0
            w[s] = total  # the right-hand side
        forward_solve(W, q, w)
        backward_solve(W, q, w)
        for s in range(q):
            if c < n:
                K[c, s] = w[s]
            else:
                Sinv[s, c - n] = w[s]
    for s in range(q):
        a[s] = 0.0
        for t in range(q):
            a[s] += Sinv[s, t] * innovation[seen[t]]
    return q


@routine
def _update_adjoint(  # type: ignore[no-untyped-def]
    q, seen, Hs, Sinv, K, a, U_pred, U_filt, innovation, m_, P_, h_, H_, R_, P, J, M, Km, X, W
):
    """Turn m_filt_, P_filt_ into m_pred_, P_pred_ (in m_, P_; without what goes through h and H).

    Writes the weights h_ (ny,) and H_ (ny, n), zero where an output is missing; adds to R_.
    """
    n = K.shape[0]
    h_[:] = 0.0
    H_[:, :] = 0.0
    Ks, Ms, As = K[:, :q], M[:q, :q], Hs[:q]
    for s in range(q):
        Km[s] = 0.0
        for i in range(n):
            Km[s] += K[i, s] * m_[i]
        h_[seen[s]] = a[s] - Km[s]
        for t in range(q):
            M[s, t] = 0.5 * (a[s] * a[t] - Sinv[s, t])
    # R: M + K' P_ K - sym(K' m_ a').
    _sandwich(Ks, P_, Ks, X, W)
    for s in range(q):
        for t in range(q):
            R_[seen[s], seen[t]] += M[s, t] + X[s, t] - 0.5 * (Km[s] * a[t] + a[s] * Km[t])
    # H: 2 M H P_pred + a (P_filt m_)' - K' m_ (K nu)' - 2 K' P_ P_filt.
    _gram(U_pred, P)
    _sandwich(Ms, As, P, X, W)
    for s in range(q):
        for j in range(n):
            H_[seen[s], j] = 2.0 * X[s, j]
    _gram(U_filt, P)
    _sandwich(Ks, P_, P, X, W)
    for j in range(n):
        shift, moved = 0.0, 0.0
        for s in range(q):
            shift += K[j, s] * innovation[seen[s]]
        for i in range(n):
            moved += P[j, i] * m_[i]
        for s in range(q):
            H_[seen[s], j] += a[s] * moved - Km[s] * shift - 2.0 * X[s, j]
    # J' = I - H' K', then the prediction's own weights.
    for i in range(n):
        for j in range(n):
            J[i, j] = 1.0 if i == j else 0.0
            for s in range(q):
                J[i, j] -= K[i, s] * Hs[s, j]
    _sandwich(J, P_, J, P, W)
    _sandwich(As, Ms, As, X, W)
    for j in range(n):
        Jm, Ha = 0.0, 0.0
        for i in range(n):
            Jm += J[i, j] * m_[i]
        for s in range(q):
            Ha += Hs[s, j] * a[s]
        W[0, j] = Jm
        W[1, j] = Ha
    for i in range(n):
        for j in range(n):
            P_[i, j] = P[i, j] + X[i, j] + 0.5 * (W[0, i] * W[1, j] + W[1, i] * W[0, j])


@kernel(
    types.void(
        types.int64, DriftJacobian, Adjoint, Adjoint, vector, vector, matrix, matrix, matrix,
        matrix, cube, matrix, cube, cube, cube, cube, matrix, matrix, matrix, vector, matrix, vector,
    ),
    allocates=True,
)  # fmt: skip
def run_back(  # type: ignore[no-untyped-def]
    scheme, drift_jacobian, drift_adjoint, output_adjoint, p, dt, u, Q, UR,
    m_pred, U_pred, m_filt, U_filt, F, G, H, innovation, Q_, R_, m_, P_, p_,
):  # fmt: skip
    """Run backward; Q_, R_ and p_ are added to, m_ and P_ end as the weights of the first state's moments."""
    n, nv, ny = m_pred.shape[1], Q.shape[0], UR.shape[0]
    b = max(n, nv, ny, 2)
    s = _Scratch(
        np.empty(ny, dtype=np.int64), np.empty((ny, n)), np.empty((ny, ny)), np.empty((ny, ny)), np.empty((n, ny)),
        np.empty((n, ny)), np.empty(ny), np.empty(ny), np.empty((n, n)), np.empty((n, n)), np.empty((b, b)),
        np.empty((ny + b, b)), np.empty((n, n)), np.empty((n, nv)), np.empty(ny * (1 + n)), np.empty(n + ny),
        np.empty(n), np.empty(p.size), np.empty(adjoint_work_size(n, nv, p.size)),
    )  # fmt: skip
    _steps(
        scheme, drift_jacobian, drift_adjoint, output_adjoint, p, dt, u, Q, UR,
        m_pred, U_pred, m_filt, U_filt, F, G, H, innovation, Q_, R_, m_, P_, p_, s,
    )  # fmt: skip


class _Scratch(NamedTuple):
    """What ``_steps`` works in."""

    seen: Any  # (ny,)
    Hs: Any  # (ny, n)
    Sinv: Any  # (ny, ny)
    M: Any  # (ny, ny)
    K: Any  # (n, ny)
    V: Any  # (n, ny)
    a: Any  # (ny,)
    Km: Any  # (ny,)
    P: Any  # (n, n)
    J: Any  # (n, n)
    X: Any  # (b, b), b the largest of n, nv, ny and 2
    W: Any  # (ny + b, b)
    F_: Any  # (n, n)
    G_: Any  # (n, nv)
    w_out: Any  # (ny (1 + n),)
    w: Any  # (n + ny,)
    gx: Any  # (n,)
    gp: Any  # (np,)
    work: Any


@routine
def _steps(  # type: ignore[no-untyped-def]
    scheme, drift_jacobian, drift_adjoint, output_adjoint, p, dt, u, Q, UR,
    m_pred, U_pred, m_filt, U_filt, F, G, H, innovation, Q_, R_, m_, P_, p_, s,
):  # fmt: skip
    """The loop of ``run_back``."""
    N, n = m_pred.shape
    nv, ny = Q.shape[0], UR.shape[0]
    seen, Hs, Sinv, K, a, P, X, W, F_, G_ = s.seen, s.Hs, s.Sinv, s.K, s.a, s.P, s.X, s.W, s.F_, s.G_
    h_, H_, gx, gp = s.w_out[:ny], s.w_out[ny:].reshape(ny, n), s.gx, s.gp
    m_[:] = 0.0
    P_[:, :] = 0.0
    for k in range(N - 1, -1, -1):
        if k < N - 1:
            # F_ = 2 P_ F P_filt, G_ = 2 P_ G Q.
            _gram(U_filt[k], P)
            _sandwich(P_, F[k], P, F_, W)
            _sandwich(P_, G[k], Q, G_, W)
            for i in range(n):
                for j in range(n):
                    F_[i, j] *= 2.0
                for j in range(nv):
                    G_[i, j] *= 2.0
            transition_adjoint(
                scheme, drift_jacobian, drift_adjoint, m_filt[k], u[k], dt[k], p, m_, F_, G_, gx, gp, s.work
            )
            for i in range(n):
                m_[i] = gx[i]
            for j in range(p.size):
                p_[j] += gp[j]
            _sandwich(G[k], P_, G[k], X, W)
            for i in range(nv):
                for j in range(nv):
                    Q_[i, j] += X[i, j]
            _sandwich(F[k], P_, F[k], P, W)
            for i in range(n):
                for j in range(n):
                    P_[i, j] = P[i, j]
        q = _innovation_parts(U_pred[k], H[k], UR, innovation[k], seen, Hs, Sinv, K, a, W, s.V, s.w)
        if q == 0:
            continue
        _update_adjoint(
            q, seen, Hs, Sinv, K, a, U_pred[k], U_filt[k], innovation[k], m_, P_, h_, H_, R_, P, s.J, s.M, s.Km, X, W
        )
        output_adjoint(m_pred[k], u[k], p, s.w_out, gx, gp)
        for i in range(n):
            m_[i] += gx[i]
        for j in range(p.size):
            p_[j] += gp[j]

"""The paper's own form of the E- and M-step: an extended Kalman smoother on the stacked state (x_{k-1}, x_k).

axelsson2011_poster, "The E-step" and "The M-step", in many digits: its predicted covariance is singular, so the
smoother is the Bryson-Frazier one, which inverts only innovation covariances.
"""

from __future__ import annotations

import mpmath
import numpy as np
from covariance_form import measure, step


def stacked_m_step(model, recording, noise, digits=40):
    """Q_{l+1} of one EM pass over one test, and the smoothed joint moments of (x_{k-1}, x_k), k = 2..N."""
    n, N = model.nx, recording.samples
    with mpmath.workdps(digits):
        mp = mpmath.matrix
        Q, R = mp(noise.Q.tolist()), mp(noise.R.tolist())
        m, P = mp(np.concatenate([noise.m0[0]] * 2).tolist()), mpmath.zeros(2 * n)
        for i in range(n):
            for j in range(n):
                P[n + i, n + j] = mpmath.mpf(float(noise.P0[i, j]))
        store = []
        for k in range(N):
            y_hat, H = measure(model, _float(m)[n:], recording.u[k])
            seen = [i for i in range(model.ny) if not np.isnan(recording.y[k, i])]
            Hs = mpmath.zeros(len(seen), 2 * n)
            for r, i in enumerate(seen):
                for j in range(n):
                    Hs[r, n + j] = mpmath.mpf(float(H[i, j]))
            nu = mp([recording.y[k, i] - y_hat[i] for i in seen])
            S = Hs * P * Hs.T + mp([[R[i, j] for j in seen] for i in seen])
            S_inv = S**-1
            K = P * Hs.T * S_inv
            m_filt, P_filt = m + K * nu, P - K * S * K.T
            x_next, F, G = step(model, _float(m_filt)[n:], recording.u[k], recording.dt[k] if k < N - 1 else 1.0)
            A, B = mpmath.zeros(2 * n), mpmath.zeros(2 * n, model.nv)
            for i in range(n):
                A[i, n + i] = 1
                for j in range(n):
                    A[n + i, n + j] = mpmath.mpf(float(F[i, j]))
                for j in range(model.nv):
                    B[n + i, j] = mpmath.mpf(float(G[i, j]))
            store.append((m, P, Hs, S_inv, nu, K, A))
            m = mp([m_filt[n + i] for i in range(n)] + [mpmath.mpf(float(v)) for v in x_next])
            P = A * P_filt * A.T + B * Q * B.T
        lam, Lam = mpmath.zeros(2 * n, 1), mpmath.zeros(2 * n)
        moments = [None] * N
        for k in range(N - 1, -1, -1):
            m, P, Hs, S_inv, nu, K, A = store[k]
            if k < N - 1:
                lam, Lam = A.T * lam, A.T * Lam * A
            C = mpmath.eye(2 * n) - K * Hs
            lam = C.T * lam + Hs.T * S_inv * nu
            Lam = C.T * Lam * C + Hs.T * S_inv * Hs
            moments[k] = (_float(m + P * lam), P - P * Lam * P)
        total = mpmath.zeros(model.nv)
        for k in range(1, N):
            xi, cov = moments[k]
            x_next, J1, F2 = step(model, np.ascontiguousarray(xi[:n]), recording.u[k - 1], recording.dt[k - 1])
            T = mpmath.zeros(n, 2 * n)
            for i in range(n):
                T[i, n + i] = 1
                for j in range(n):
                    T[i, j] = -mpmath.mpf(float(J1[i, j]))
            r = mp((xi[n:] - x_next).tolist())
            pinv = mp(np.linalg.pinv(F2).tolist())
            total += pinv * (T * cov * T.T + r * r.T) * pinv.T
        return _float(total / (N - 1)).reshape(model.nv, model.nv), moments


def _float(M):
    """An mpmath matrix as floats; a column becomes a vector."""
    out = np.array([[float(M[i, j]) for j in range(M.cols)] for i in range(M.rows)])
    return np.ascontiguousarray(out[:, 0]) if M.cols == 1 else out

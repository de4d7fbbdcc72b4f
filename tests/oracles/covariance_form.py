"""The textbook filter and smoother in covariance form, one obvious line per equation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from one_step import transition, workspace


def step(model, x, u, dt):
    """F1, its Jacobian and F2 of one step."""
    n, nv = model.nx, model.nv
    x_next, F, G = np.empty(n), np.empty((n, n)), np.empty((n, nv))
    work = workspace(n, nv)
    transition(model.scheme, model.drift_jacobian, x, u, dt, model.parameters, x_next, F, G, work)
    return x_next, F, G


def measure(model, x, u):
    """H and its Jacobian."""
    y, H = np.empty(model.ny), np.empty((model.ny, model.nx))
    model.output_jacobian(x, u, model.parameters, y, H)
    return y, H


@dataclass
class Twin:
    """Everything that the textbook recursions give."""

    m_pred: list
    P_pred: list
    m_filt: list
    P_filt: list
    F: list
    G: list
    loglik: float


def filter_twin(model, recording, noise, test=0):
    """Extended Kalman filter: P - K S K' and inverses, as in any textbook."""
    t = Twin([], [], [], [], [], [], 0.0)
    m, P = noise.m0[test], noise.P0
    for k in range(recording.samples):
        t.m_pred.append(m)
        t.P_pred.append(P)
        y_hat, H = measure(model, m, recording.u[k])
        seen = ~np.isnan(recording.y[k])
        if seen.any():
            H, nu = H[seen], (recording.y[k] - y_hat)[seen]
            S = H @ P @ H.T + noise.R[np.ix_(seen, seen)]
            K = P @ H.T @ np.linalg.inv(S)
            m = m + K @ nu
            P = P - K @ S @ K.T
            t.loglik -= 0.5 * (seen.sum() * np.log(2 * np.pi) + np.linalg.slogdet(S)[1] + nu @ np.linalg.solve(S, nu))
        t.m_filt.append(m)
        t.P_filt.append(P)
        if k < recording.samples - 1:
            m, F, G = step(model, m, recording.u[k], recording.dt[k])
            P = F @ P @ F.T + G @ noise.Q @ G.T
            t.F.append(F)
            t.G.append(G)
    return t


def smoother_twin(t):
    """Rauch-Tung-Striebel smoother; returns means, covariances and Cov(x_{k+1}, x_k | all y)."""
    N = len(t.m_filt)
    m, P, lag = [None] * N, [None] * N, [None] * (N - 1)
    m[-1], P[-1] = t.m_filt[-1], t.P_filt[-1]
    for k in range(N - 2, -1, -1):
        X = t.P_filt[k] @ t.F[k].T @ np.linalg.inv(t.P_pred[k + 1])
        m[k] = t.m_filt[k] + X @ (m[k + 1] - t.m_pred[k + 1])
        P[k] = t.P_filt[k] + X @ (P[k + 1] - t.P_pred[k + 1]) @ X.T
        lag[k] = P[k + 1] @ X.T
    return np.array(m), np.array(P), np.array(lag)

"""The joint Gaussian of all states, noises and outputs of a linear model, conditioned on the outputs."""

from __future__ import annotations

import numpy as np


def dense_posterior(A, B, G, C, D, recording, Q, R, m0, P0):
    """Condition the stacked vector (x_1..x_N, v_1..v_{N-1}) on the observed outputs.

    Returns:
        mean and covariance of the stacked vector given y, and the log-likelihood of y.
    """
    n, nv, N = len(A), G.shape[1], recording.samples
    size = N * n + (N - 1) * nv
    # Everything is a linear map of (x_1, v_1, ..., v_{N-1}) plus a known part.
    basis = n + (N - 1) * nv
    T = np.zeros((size, basis))
    known = np.zeros(size)
    T[:n, :n] = np.eye(n)
    for k in range(N - 1):
        now, after = slice(k * n, (k + 1) * n), slice((k + 1) * n, (k + 2) * n)
        v = slice(n + k * nv, n + (k + 1) * nv)
        T[after] = A @ T[now]
        T[after, v] += G
        known[after] = A @ known[now] + B @ recording.u[k]
        T[N * n + k * nv : N * n + (k + 1) * nv, v] = np.eye(nv)
    root_mean = np.concatenate([m0, np.zeros((N - 1) * nv)])
    root_cov = np.zeros((basis, basis))
    root_cov[:n, :n] = P0
    for k in range(N - 1):
        v = slice(n + k * nv, n + (k + 1) * nv)
        root_cov[v, v] = Q
    mean, cov = T @ root_mean + known, T @ root_cov @ T.T

    seen = ~np.isnan(recording.y.ravel())
    H = np.zeros((N * len(C), size))
    for k in range(N):
        H[k * len(C) : (k + 1) * len(C), k * n : (k + 1) * n] = C
    H = H[seen]
    nu = (recording.y - recording.u @ D.T).ravel()[seen] - H @ mean
    S = H @ cov @ H.T + np.kron(np.eye(N), R)[np.ix_(seen, seen)]
    K = np.linalg.solve(S, H @ cov).T
    loglik = -0.5 * (seen.sum() * np.log(2 * np.pi) + np.linalg.slogdet(S)[1] + nu @ np.linalg.solve(S, nu))
    return mean + K @ nu, cov - K @ H @ cov, loglik


def dense_outputs(A, B, G, C, D, recording, Q, R, m0, P0):
    """Mean and covariance of the observed outputs, sample by sample, before any is seen."""
    n, N = len(A), recording.samples
    mean, cov = [m0], np.zeros((N * n, N * n))
    cov[:n, :n] = P0
    for k in range(N - 1):
        now, after = slice(k * n, (k + 1) * n), slice((k + 1) * n, (k + 2) * n)
        mean.append(A @ mean[k] + B @ recording.u[k])
        cov[after, : after.start] = A @ cov[now, : after.start]
        cov[: after.start, after] = cov[after, : after.start].T
        cov[after, after] = A @ cov[now, now] @ A.T + G @ Q @ G.T
    seen = ~np.isnan(recording.y.ravel())
    H = np.kron(np.eye(N), C)[seen]
    means = (np.array(mean) @ C.T + recording.u @ D.T).ravel()[seen]
    return means, H @ cov @ H.T + np.kron(np.eye(N), R)[np.ix_(seen, seen)]

"""The sigma-point filter, smoother and M-step moments in covariance form, with the textbook's weights: a slow twin."""

from dataclasses import dataclass

import numpy as np
from one_step import transition, workspace


@dataclass
class Textbook:
    """Per sample: smoothed means and covariances, lag-one covariances, and the moments of v and e."""

    loglik: float
    m: np.ndarray
    P: np.ndarray
    lag_one: np.ndarray
    S: np.ndarray
    moment_v: np.ndarray
    moment_e: np.ndarray


def _points(m, P, weights):
    n = len(m)
    L = np.linalg.cholesky(P) * weights.eta
    return np.ascontiguousarray(np.vstack([m, m + L.T, m - L.T])), *_weights(n, weights)


def _weights(n, weights):
    outer = np.full(2 * n, weights.outer)
    return np.concatenate(([weights.mean0], outer)), np.concatenate(([weights.cov0], outer))


def _moments(values, wm, wc, others=None, other_mean=None):
    mean = wm @ values
    d = values - mean
    o = d if others is None else others - other_mean
    return mean, np.einsum("i,ij,ik->jk", wc, d, o)


def _second(values, wm, wc):
    """E[f f'] of a matrix-valued function, column by column: spread plus square of the mean."""
    out = 0.0
    for column in np.moveaxis(values, 2, 0):
        mean, spread = _moments(column, wm, wc)
        out = out + spread + np.outer(mean, mean)
    return out


def _step(model, X, u, dt):
    n, nv = model.nx, model.nv
    F1, G = np.empty((len(X), n)), np.empty((len(X), n, nv))
    F, work = np.empty((n, n)), workspace(n, nv)
    for i, x in enumerate(X):
        transition(model.scheme, model.drift_jacobian, x, u, dt, model.parameters, F1[i], F, G[i], work)
    return F1, G


def _outputs(model, X, u):
    Y = np.empty((len(X), model.ny))
    for i, x in enumerate(X):
        model.output(x, u, model.parameters, Y[i])
    return Y


def textbook(model, recording, noise, weights, test=0):
    """Run it all on one test; outputs are complete."""
    m, P, loglik = noise.m0[test], noise.P0, 0.0
    pred, filt, gains, S_all = [(m, P)], [], [], []
    root_Q = np.linalg.cholesky(noise.Q)
    for k in range(recording.samples):
        X, wm, wc = _points(m, P, weights)
        Y = _outputs(model, X, recording.u[k])
        y_hat, S = _moments(Y, wm, wc)
        S = S + noise.R
        cross = np.einsum("i,ij,ik->jk", wc, X - m, Y - y_hat)
        nu = recording.y[k] - y_hat
        loglik -= 0.5 * (nu @ np.linalg.solve(S, nu) + np.linalg.slogdet(2 * np.pi * S)[1])
        K = cross @ np.linalg.inv(S)
        m, P = m + K @ nu, P - K @ S @ K.T
        S_all.append(S)
        filt.append((m, P))
        if k < recording.samples - 1:
            X, wm, wc = _points(m, P, weights)
            F1, G = _step(model, X, recording.u[k], recording.dt[k])
            m_next, P_next = _moments(F1, wm, wc)
            P_next = P_next + _second(G @ root_Q, wm, wc)
            gains.append(np.einsum("i,ij,ik->jk", wc, X - m, F1 - m_next) @ np.linalg.inv(P_next))
            m, P = m_next, P_next
            pred.append((m, P))
    smooth = [filt[-1]]
    for k in range(recording.samples - 2, -1, -1):
        D, (ms, Ps) = gains[k], smooth[0]
        smooth.insert(0, (filt[k][0] + D @ (ms - pred[k + 1][0]), filt[k][1] + D @ (Ps - pred[k + 1][1]) @ D.T))
    lag = np.array([smooth[k + 1][1] @ gains[k].T for k in range(len(gains))])
    vv, ee = _noise_moments(model, recording, weights, smooth, lag)
    return Textbook(
        loglik, np.array([s[0] for s in smooth]), np.array([s[1] for s in smooth]), lag, np.array(S_all), vv, ee
    )


def _noise_moments(model, recording, weights, smooth, lag):
    vv, ee = 0.0, 0.0
    for k, (m, P) in enumerate(smooth):
        X, wm, wc = _points(m, P, weights)
        Y = recording.y[k] - _outputs(model, X, recording.u[k])
        ee = ee + _second(Y[:, :, None], wm, wc)
        if k < len(lag):
            m_next, P_next = smooth[k + 1]
            L = lag[k] @ np.linalg.inv(P)
            F1, G = _step(model, X, recording.u[k], recording.dt[k])
            inverse = np.linalg.pinv(G)
            v = np.einsum("ijk,ik->ij", inverse, m_next + (X - m) @ L.T - F1)
            open_part = inverse @ np.linalg.cholesky(P_next - L @ P @ L.T)
            vv = vv + _second(v[:, :, None], wm, wc) + _second(open_part, wm, wc)
    return vv / len(lag), ee / len(smooth)

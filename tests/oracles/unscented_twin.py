"""The unscented Kalman filter in covariance form, one obvious line per equation; the twin of the square-root one."""

import numpy as np
from covariance_form import measure, step


def points(x, P, w):
    S = np.linalg.cholesky(P)
    return np.ascontiguousarray(np.vstack((x, x + w.eta * S.T, x - w.eta * S.T)))


def moments(X, Y, w):
    """Means of both point sets and the cross covariance of their deviations."""
    wm = np.full(len(X), w.outer)
    wc = wm.copy()
    wm[0], wc[0] = w.mean0, w.cov0
    x, y = wm @ X, wm @ Y
    return x, y, (X - x).T @ (wc[:, None] * (Y - y))


def unscented_twin(model, recording, noise, w):
    """Filtered means and covariances, and the log-likelihood."""
    x, P, loglik, means, covariances = noise.m0[0], noise.P0, 0.0, [], []
    for k in range(recording.samples):
        if k > 0:
            X = points(x, P, w)
            G = step(model, x, recording.u[k - 1], recording.dt[k - 1])[2]
            X = np.array([step(model, point, recording.u[k - 1], recording.dt[k - 1])[0] for point in X])
            x, _, P = moments(X, X, w)
            P = P + G @ noise.Q @ G.T
        X = points(x, P, w)
        seen = ~np.isnan(recording.y[k])
        if seen.any():
            Y = np.array([measure(model, point, recording.u[k])[0] for point in X])[:, seen]
            _, y, S = moments(Y, Y, w)
            S = S + noise.R[np.ix_(seen, seen)]
            C = moments(X, Y, w)[2]
            e = recording.y[k, seen] - y
            K = C @ np.linalg.inv(S)
            x, P = x + K @ e, P - K @ S @ K.T
            loglik -= 0.5 * (len(e) * np.log(2 * np.pi) + np.linalg.slogdet(S)[1] + e @ np.linalg.solve(S, e))
        means.append(x)
        covariances.append(P)
    return np.array(means), np.array(covariances), loglik

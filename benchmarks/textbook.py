"""The EM pass as an engineer writes it in NumPy: covariances, inverses, a Python loop."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording

Array = np.ndarray
Step = Callable[[Array, Array], tuple[Array, Array, Array]]
Measure = Callable[[Array, Array], tuple[Array, Array]]


class Answer(NamedTuple):
    """What a pass ends with; None where a program does not give it.

    Attributes:
        loglik: log-likelihood of the outputs.
        Q: (nv, nv) the M-step's covariance of the process noise.
        m, P: (N, n), (N, n, n) smoothed means and covariances.
    """

    loglik: float
    Q: Array | None
    m: Array | None
    P: Array | None


def em_pass(step: Step, measure: Measure, recording: Recording, noise: NoiseValues) -> Answer:
    """Extended Kalman filter, Rauch-Tung-Striebel smoother and M-step for Q.

    Args:
        step: next state (n,), its Jacobian (n, n) and the noise gain (n, nv), of state and input.
        measure: output (ny,) and its Jacobian (ny, n).
        recording, noise: the problem; no output may be missing.
    """
    y, u, N = recording.y, recording.u, recording.samples
    m, P, loglik = noise.m0[0], noise.P0, 0.0
    predicted, filtered, jacobians = [], [], []
    for k in range(N):
        y_hat, H = measure(m, u[k])
        e = y[k] - y_hat
        S = H @ P @ H.T + noise.R
        K = np.linalg.solve(S, H @ P).T
        loglik -= 0.5 * (len(e) * np.log(2 * np.pi) + np.linalg.slogdet(S)[1] + e @ np.linalg.solve(S, e))
        m, P = m + K @ e, P - K @ S @ K.T
        # Without this the asymmetry of rounding grows: P is indefinite before sample 2000 of the robot.
        P = 0.5 * (P + P.T)
        filtered.append((m, P))
        if k < N - 1:
            m, F, G = step(m, u[k])
            P = F @ P @ F.T + G @ noise.Q @ G.T
            predicted.append((m, P))
            jacobians.append(F)
    smoothed, total = [(m, P)], np.zeros_like(noise.Q)
    for k in range(N - 2, -1, -1):
        (m_next, P_next), (m_pred, P_pred), (m_filt, P_filt) = (m, P), predicted[k], filtered[k]
        X = np.linalg.solve(P_pred, jacobians[k] @ P_filt).T
        m, P = m_filt + X @ (m_next - m_pred), P_filt + X @ (P_next - P_pred) @ X.T
        smoothed.append((m, P))
        x_next, J, G = step(m, u[k])
        r, lag = m_next - x_next, P_next @ X.T
        moment = P_next - lag @ J.T - J @ lag.T + J @ P @ J.T + np.outer(r, r)
        left = np.linalg.solve(G.T @ G, G.T)
        total += left @ moment @ left.T
    smoothed.reverse()
    return Answer(loglik, total / (N - 1), np.array([m for m, _ in smoothed]), np.array([P for _, P in smoothed]))


def compiled_functions(model: CompiledModel, dt: float) -> tuple[Step, Measure]:
    """The compiled functions of a model in noiseid, which nobody has who writes a filter in NumPy."""
    from one_step import transition, workspace

    work = workspace(model.nx, model.nv)

    def step(x: Array, u: Array) -> tuple[Array, Array, Array]:
        x_next, F, G = np.empty(model.nx), np.empty((model.nx, model.nx)), np.empty((model.nx, model.nv))
        transition(model.scheme, model.drift_jacobian, x, u, dt, model.parameters, x_next, F, G, work)
        return x_next, F, G

    def measure(x: Array, u: Array) -> tuple[Array, Array]:
        y, H = np.empty(model.ny), np.empty((model.ny, model.nx))
        model.output_jacobian(x, u, model.parameters, y, H)
        return y, H

    return step, measure

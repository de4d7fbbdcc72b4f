"""Ensembles of tests of the Markov-driven manipulator (porter1983_partitioned_recursive, section 5), in closed loop."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from noiseid_cli.models.recording import Array, Recording
from tests.oracles.markov import (
    INITIAL_STATE_MAP,
    INTERVAL,
    MEASUREMENT_VARIANCE,
    SAMPLES,
    TRUE_ALPHA,
    TRUE_COVARIANCE,
    TRUE_MEAN,
    markov_matrices,
)

POSITION_GAIN, SPEED_GAIN = 0.2, 0.6  # [chosen] 1/s^2, 1/s: closed-loop poles of modulus 0.71 at 1 s


def simulate_markov_tests(
    tests: int,
    seed: int | np.random.SeedSequence,
    samples: int | Callable[[int], int] = SAMPLES,
    mu: Array = TRUE_MEAN,
    Sigma: Array = TRUE_COVARIANCE,
    alpha: Array = TRUE_ALPHA,
    interval: float = INTERVAL,
) -> tuple[Recording, ...]:
    """An ensemble of independent tests in closed loop: lambda = -k1 x1^ - k2 x2^ - x3^ from a Kalman filter on z.

    Each test has its own random stream, so that the first tests do not depend on how many follow.

    Args:
        tests: how many.
        seed: root of the tests' streams.
        samples: measurements of each test, or a function from the test's index to it.
        mu, Sigma: (2,), (2, 2) law of (x1, x2)(0), m and m/s.
        alpha: (2,) q and 1/tau.
        interval: s.

    Returns:
        Recordings of ``samples`` + 1 samples; the first has no measurement and lambda = 0 over its interval.
    """
    root = seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
    streams = root.spawn(tests)
    out = []
    for i, stream in enumerate(streams):
        n = samples(i) if callable(samples) else samples
        out.append(_simulate(f"test-{i + 1}", n, np.random.default_rng(stream), mu, Sigma, alpha, interval))
    return tuple(out)


def _simulate(
    name: str, n: int, rng: np.random.Generator, mu: Array, Sigma: Array, alpha: Array, interval: float
) -> Recording:
    """One closed-loop test; the controller's filter knows the true parameters."""
    blank = Recording(name, np.full(n, interval), np.zeros((n + 1, 1)), np.full((n + 1, 1), np.nan))
    model = markov_matrices(alpha, blank)
    A, B, Q, C, T = model.A[0], model.B[0], model.Q[0], model.C[0], INITIAL_STATE_MAP
    P = T @ Sigma @ T.T + model.S_a
    m = T @ mu
    x = rng.multivariate_normal(m, P)
    w = rng.multivariate_normal(np.zeros(3), Q, size=n)
    v = np.sqrt(MEASUREMENT_VARIANCE) * rng.normal(size=n)
    gain = np.array([POSITION_GAIN, SPEED_GAIN, 1.0])
    states = np.empty((n + 1, 3))
    states[0] = x
    for k in range(n):
        u = blank.u[k]
        x, m, P = A @ x + B @ u + w[k], A @ m + B @ u, A @ P @ A.T + Q
        blank.y[k + 1] = C @ x + v[k]
        K = P @ C.T / (C @ P @ C.T + MEASUREMENT_VARIANCE)
        m, P = m + K @ (blank.y[k + 1] - C @ m), P - K @ C @ P
        blank.u[k + 1] = -gain @ m
        states[k + 1] = x
    return Recording(name, blank.dt, blank.u, blank.y, x_true=states)

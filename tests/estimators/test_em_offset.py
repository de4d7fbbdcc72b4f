"""Plain EM on a linear model of five states with a known offset that varies over time, its first output row missing."""

import numpy as np
import pytest
from random_models import random_covariance

from noiseid_cli.estimators import em
from noiseid_cli.estimators.em import EmOptions
from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.estimators.unknowns import Unknowns
from noiseid_cli.models.linear import linear_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording


def offset_case(seed, N=400):
    """X next = A x + b_k + v, y = C x + d_k + e with known offsets b_k and d_k, which enter as inputs."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(5, 5))
    A *= 0.95 / np.max(np.abs(np.linalg.eigvals(A)))
    C = rng.normal(size=(2, 5))
    Q, R = random_covariance(rng, 5), random_covariance(rng, 2)
    b = np.cumsum(rng.normal(size=(N, 5)), axis=0)
    d = 3.0 * np.sin(np.arange(N)[:, None] / np.array([7.0, 30.0]))
    x, y = np.zeros(5), np.empty((N, 2))
    for k in range(N):
        y[k] = C @ x + d[k] + rng.multivariate_normal(np.zeros(2), R)
        x = A @ x + b[k] + rng.multivariate_normal(np.zeros(5), Q)
    y[0] = np.nan
    B, D = np.hstack([np.eye(5), np.zeros((5, 2))]), np.hstack([np.zeros((2, 5)), np.eye(2)])
    recording = Recording("offset", np.ones(N - 1), np.hstack([b, d]), y)
    return linear_model(A, np.eye(5), C, B, D), recording, NoiseValues(Q, R, np.zeros((1, 5)), np.eye(5))


@pytest.mark.parametrize("seed", range(3))
def test_fifty_plain_iterations_rise_and_keep_both_covariances_positive_definite(seed):
    model, recording, noise = offset_case(seed)
    start = NoiseValues(np.diag([100.0, 10, 1, 0.1, 0.01]), np.diag([30.0, 0.03]), noise.m0, noise.P0)
    unknowns = Unknowns(Q=CovarianceStructure.full(start.Q), R=CovarianceStructure.full(start.R))
    options = EmOptions(acceleration="none", max_passes=51, loglik_tolerance=-1.0)
    result = em.estimate(model, [recording], start, unknowns, options)
    loglik = result.trace["loglik"]
    assert len(loglik) == 51
    assert np.all(np.diff(loglik) > 0.0)
    for letter in ("Q", "R"):
        for value in result.trace[letter]:
            assert np.array_equal(value, value.T)
            assert np.linalg.eigvalsh(value)[0] > 0.0
    # The offset is used: without it the data are far less probable.
    blind = Recording("blind", recording.dt, np.zeros_like(recording.u), recording.y)
    at_end = em.estimate(model, [blind], result.final, unknowns, EmOptions(max_passes=1))
    assert at_end.loglik < result.loglik - 1000.0

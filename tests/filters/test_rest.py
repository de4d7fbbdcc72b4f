"""Covariances that have come to rest are those of the recursion that is carried on."""

import numpy as np
import pytest
from covariance_form import filter_twin, smoother_twin

from noiseid_cli.estimators.em_statistics import FILTERED, SMOOTHED, e_step
from noiseid_cli.filters.ekf import extended_kalman_filter
from noiseid_cli.filters.smoother import extended_kalman_smoother, filter_to_smooth
from noiseid_cli.models.linear import linear_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording

A = np.array([[0.9, 0.2, 0.0], [-0.1, 0.8, 0.1], [0.0, 0.0, 0.7]])
C = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
NOISE = NoiseValues(np.diag([0.3, 0.2, 0.1]), np.diag([1.0, 0.5]), np.zeros((1, 3)), np.eye(3))


def case(samples=400, missing=()):
    """A stable constant model and a test of it; ``missing`` lists samples without the first output."""
    rng = np.random.default_rng(4)
    y = rng.normal(size=(samples, 2))
    y[list(missing), 0] = np.nan
    return linear_model(A, np.eye(3), C), Recording("test", np.ones(samples - 1), np.zeros((samples, 0)), y)


def still(U):
    """(N - 1,) whether a factor is the one before to the last bit."""
    return (U[1:] == U[:-1]).all(axis=(1, 2))


def agree(model, recording, noise):
    """Filter and smoother against covariances computed at every step; returns the factors of the prediction."""
    found = extended_kalman_filter(model, recording, noise)
    twin = filter_twin(model, recording, noise)
    m, P, lag = smoother_twin(twin)
    smoothed = extended_kalman_smoother(filter_to_smooth(model, recording, noise))
    assert found.loglik == pytest.approx(twin.loglik, rel=1e-12)
    np.testing.assert_allclose(found.m_filt, twin.m_filt, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(smoothed.m, m, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(smoothed.P, P, rtol=1e-10, atol=1e-13)
    np.testing.assert_allclose(smoothed.lag_one, lag, rtol=1e-10, atol=1e-13)
    return found.U_pred


def test_a_constant_model_comes_to_rest_at_the_values_of_the_whole_recursion():
    U = agree(*case(), NOISE)
    assert still(U)[150:].all()
    assert not still(U)[:15].any()


def test_a_missing_output_wakes_the_recursion():
    U = agree(*case(800, missing=[300, 301]), NOISE)
    assert still(U)[200:300].all()
    assert not still(U)[300:316].any()
    assert still(U)[500:].all()


def test_an_output_that_is_never_measured_leaves_a_rest_of_its_own():
    assert still(agree(*case(missing=range(400)), NOISE))[-100:].all()


def test_an_interval_of_another_length_wakes_the_recursion():
    """The step is exact in time: its matrices follow the interval."""
    from dataclasses import replace

    from noiseid_cli.models.schemes import SCHEMES

    model, recording = case(800)
    model = replace(linear_model(A - np.eye(3), np.eye(3), C), scheme=SCHEMES["exact"])
    dt = np.ones(799)
    dt[400] = 1.5
    U = agree(model, replace(recording, dt=dt), NOISE)
    assert still(U)[300:400].all()
    assert not still(U)[401:410].any()


def test_a_constant_that_is_learned_for_ever_never_rests():
    """P = 1 / (1 + k): the change of a step falls far below the value, but the change over half of the steps never."""
    N = 5000
    model = linear_model([[1.0]], [[1.0]], [[1.0]])
    noise = NoiseValues(np.zeros((1, 1)), np.eye(1), np.zeros((1, 1)), np.eye(1))
    found = extended_kalman_filter(model, Recording("c", np.ones(N - 1), np.zeros((N, 0)), np.zeros((N, 1))), noise)
    np.testing.assert_allclose(found.U_pred[:, 0, 0] ** -2, 1.0 + np.arange(N), rtol=1e-12)


@pytest.mark.parametrize("linearisation", [SMOOTHED, FILTERED])
def test_statistics_at_rest_are_those_of_single_steps(linearisation):
    """The moments of one long test are the sums over its smoothed samples, written out."""
    model, recording = case(missing=[200])
    found = e_step(model, [recording], NOISE, linearisation, np.array([0, 1]))
    m, P, lag = smoother_twin(filter_twin(model, recording, NOISE))
    v = m[1:] - m[:-1] @ A.T
    spread = P[1:] - lag @ A.T - A @ lag.transpose(0, 2, 1) + A @ P[:-1] @ A.T
    np.testing.assert_allclose(found.moment_v, (v.T @ v + spread.sum(axis=0)) / len(v), rtol=1e-10, atol=1e-12)
    seen = ~np.isnan(recording.y)
    e = np.where(seen, recording.y - m @ C.T, 0.0)
    spread = np.where(seen[:, :, None] & seen[:, None, :], C @ P @ C.T, 0.0)
    samples = seen.sum(axis=0)
    expected = (e.T @ e + spread.sum(axis=0)) / np.sqrt(np.outer(samples, samples))
    np.testing.assert_allclose(found.moment_e, expected, rtol=1e-10, atol=1e-12)

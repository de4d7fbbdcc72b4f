"""The sigma-point filter and smoother against their textbook form, the Kalman filter, and exact expectations."""

import numpy as np
import pytest
from pendulum import pendulum_case
from random_models import random_case
from textbook_unscented import textbook

from noiseid_cli.errors import EstimationError
from noiseid_cli.filters.ekf import FilterDivergedError, extended_kalman_filter
from noiseid_cli.filters.sigma_filter import sigma_point_filter
from noiseid_cli.filters.sigma_points import cubature, unscented
from noiseid_cli.filters.sigma_rows import pair_centre, split
from noiseid_cli.filters.sigma_smoother import sigma_point_smoother
from noiseid_cli.filters.smoother import extended_kalman_smoother, filter_to_smooth
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording

RULES = {
    "cubature": cubature,
    "unscented": lambda n: unscented(n, 1.0),
    "wide": lambda n: unscented(n, 1.3, 2.5, 0.5),
    "negative": lambda n: unscented(n, 0.05, 2.0, 0.0),
}


@pytest.mark.parametrize("rule", RULES)
def test_rows_are_the_weighted_covariance(rule):
    """Also where the central weight of the textbook's sum is negative."""
    n, m = 4, 3
    weights = RULES[rule](n)
    values = np.random.default_rng(3).normal(size=(2 * n + 1, m))
    mean, rows = np.empty(m), np.empty((2 * n, m))
    assert split(values, weights.eta, pair_centre(weights, n), mean, rows)
    wm = np.full(2 * n + 1, weights.outer)
    wc = wm.copy()
    wm[0], wc[0] = weights.mean0, weights.cov0
    expected = wm @ values
    d = values - expected
    size = np.einsum("i,ij,ij->j", np.abs(wc), d, d).max()
    assert np.allclose(mean, expected, rtol=0, atol=1e-14 * np.abs(wm).sum() * 10)
    assert np.allclose(rows.T @ rows, np.einsum("i,ij,ik->jk", wc, d, d), rtol=0, atol=1e-12 * size)


def test_a_constant_has_no_rows():
    weights = cubature(2)
    mean, rows = np.empty(1), np.empty((4, 1))
    assert not split(np.full((5, 1), 7.0), weights.eta, pair_centre(weights, 2), mean, rows)
    assert mean[0] == 7.0
    assert np.all(rows == 0.0)


def test_weights_that_can_give_a_negative_variance_are_refused():
    with pytest.raises(EstimationError, match=r"beta - alpha\^2 is -1 and must be -0.375 at least"):
        pair_centre(unscented(8, 1.0, 0.0), 8)


@pytest.mark.parametrize("rule", RULES)
def test_nonlinear_model_equals_the_textbook_form(rule):
    """Pendulum: nonlinear output, gain of the noise that depends on the state, unequal intervals."""
    model, noise, recordings = pendulum_case(5, lengths=(25,))
    weights = RULES[rule](2)
    twin = textbook(model, recordings[0], noise, weights)
    filtered = sigma_point_filter(model, recordings[0], noise, weights)
    smoothed = sigma_point_smoother(filtered)
    tolerance = 1e-10 * max(1.0, abs(weights.cov0))
    assert filtered.loglik == pytest.approx(twin.loglik, abs=100 * tolerance)
    assert np.allclose(filtered.S, twin.S, rtol=100 * tolerance)
    assert np.allclose(smoothed.m, twin.m, rtol=0, atol=tolerance)
    assert np.allclose(smoothed.P, twin.P, rtol=0, atol=tolerance)
    assert np.allclose(smoothed.lag_one, twin.lag_one, rtol=0, atol=tolerance)
    # The points see the curvature that the linearisation does not.
    assert abs(filtered.loglik - extended_kalman_filter(model, recordings[0], noise).loglik) > 1e-3


@pytest.mark.parametrize("rule", ["cubature", "unscented", "wide"])
@pytest.mark.parametrize("seed", range(4))
def test_linear_model_equals_the_kalman_filter_and_smoother(seed, rule):
    case = random_case(seed, 3, 2, 2, lengths=(30,), missing=0.3)
    recording = case.recordings[0]
    mine = sigma_point_filter(case.model, recording, case.noise, RULES[rule](3))
    theirs = extended_kalman_filter(case.model, recording, case.noise)
    b = extended_kalman_smoother(filter_to_smooth(case.model, case.recordings[0], case.noise))
    a = sigma_point_smoother(mine)
    assert mine.loglik == pytest.approx(theirs.loglik, abs=1e-10)
    assert np.allclose(mine.m_filt, theirs.m_filt, rtol=0, atol=1e-10)
    assert np.allclose(mine.S, theirs.S, rtol=1e-10)
    for mine_value, their_value in ((a.m, b.m), (a.P, b.P), (a.lag_one, b.lag_one)):
        assert np.allclose(mine_value, their_value, rtol=0, atol=1e-10)


def test_an_exactly_known_state_is_counted_and_smoothed():
    """P0 = 0 and one noise for three states: the predicted covariance is singular at first."""
    case = random_case(2, 3, 1, 2, lengths=(12,), missing=0.2)
    noise = NoiseValues(case.noise.Q, case.noise.R, case.noise.m0, np.zeros((3, 3)))
    filtered = sigma_point_filter(case.model, case.recordings[0], noise, cubature(3))
    other = extended_kalman_smoother(filter_to_smooth(case.model, case.recordings[0], noise))
    smoothed = sigma_point_smoother(filtered)
    assert filtered.singular == other.singular > 0
    assert np.allclose(smoothed.m, other.m, rtol=0, atol=1e-9)
    assert np.allclose(smoothed.P, other.P, rtol=0, atol=1e-9)


def test_a_filter_that_fails_says_where():
    model, noise, recordings = pendulum_case(0, lengths=(5,))
    huge = NoiseValues(noise.Q, noise.R, np.array([[1e200, 1e200]]), noise.P0)
    with pytest.raises(FilterDivergedError, match=r"test 'test-0': .* at sample"):
        sigma_point_filter(model, recordings[0], huge, cubature(2))
    exact = NoiseValues(noise.Q, np.zeros((2, 2)), noise.m0, np.zeros((2, 2)))
    still = Recording("still", recordings[0].dt, recordings[0].u, recordings[0].y)
    with pytest.raises(FilterDivergedError, match="innovation covariance is singular"):
        sigma_point_filter(model, still, exact, cubature(2))

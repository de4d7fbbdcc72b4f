"""The innovation test for outliers."""

import numpy as np
import pytest
from random_models import random_case
from scipy.special import chdtri

from noiseid_cli.errors import EstimationError
from noiseid_cli.filters.ekf import extended_kalman_filter
from noiseid_cli.filters.gate import OutlierGate, find_outliers
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording


def spoiled(case, places):
    r = case.recordings[0]
    y = r.y.copy()
    for k, j, size in places:
        y[k, j] += size
    return Recording(r.name, r.dt, r.u, y)


@pytest.mark.parametrize("per", ["sample", "output"])
def test_finds_what_was_put_in_and_goes_on_as_if_it_were_missing(per):
    case = random_case(8, 3, 2, 2, lengths=(60,), missing=0.1)
    places = [(k, j, 200.0) for k, j in ((7, 0), (8, 1), (30, 0)) if np.isfinite(case.recordings[0].y[k, j])]
    bad = spoiled(case, places)
    found = find_outliers(case.model, bad, case.noise, OutlierGate(1e-9, per))
    rows = {k for k, _, _ in places}
    expected = np.zeros(bad.y.shape, dtype=bool)
    for k, j, _ in places:
        expected[k, slice(None) if per == "sample" else j] = True
    expected &= np.isfinite(bad.y)
    assert len(rows) >= 2
    assert np.array_equal(found.dropped, expected)
    # The deviations are those of a filter that has never seen the outliers.
    clean = Recording("clean", bad.dt, bad.u, np.where(found.dropped, np.nan, bad.y))
    filtered = extended_kalman_filter(case.model, clean, case.noise)
    S = np.diagonal(filtered.S, axis1=1, axis2=2)
    kept = np.isfinite(clean.y)
    assert np.allclose(found.deviation[kept], (filtered.innovation / np.sqrt(S))[kept], rtol=1e-12)
    assert np.array_equal(np.isnan(found.deviation), np.isnan(bad.y))


def test_the_limit_is_the_quantile():
    """One sample, two outputs: turned away just above the quantile of two degrees of freedom, kept just below."""
    case = random_case(3, 2, 1, 2, lengths=(2,), missing=0.0)
    r = case.recordings[0]
    filtered = extended_kalman_filter(case.model, r, case.noise)
    direction = np.linalg.cholesky(filtered.S[0]) @ np.array([0.6, 0.8])
    y_hat = r.y[0] - filtered.innovation[0]
    for factor, dropped in ((0.999, False), (1.001, True)):
        y = r.y.copy()
        y[0] = y_hat + factor * np.sqrt(chdtri(2, 0.01)) * direction
        found = find_outliers(case.model, Recording("a", r.dt, r.u, y), case.noise, OutlierGate(0.01))
        assert found.dropped[0].all() == dropped
        assert found.dropped[0].any() == dropped


def test_a_right_filter_turns_away_the_share_that_was_asked_for():
    case = random_case(5, 2, 2, 1, lengths=(4000,), missing=0.0)
    share = find_outliers(case.model, case.recordings[0], case.noise, OutlierGate(0.05)).dropped.mean()
    # Turning away the tail widens nothing else by much: binomial scatter of 4000 trials, 4 standard deviations.
    assert abs(share - 0.05) < 4 * np.sqrt(0.05 * 0.95 / 4000)


def test_a_probability_that_is_none_is_refused():
    case = random_case(0)
    with pytest.raises(EstimationError, match="must be between 0 and 1"):
        find_outliers(case.model, case.recordings[0], case.noise, OutlierGate(1.0))


def test_the_second_test_has_its_own_first_state():
    case = random_case(4, 2, 1, 1, lengths=(5, 5), missing=0.0)
    noise = NoiseValues(case.noise.Q, case.noise.R, case.noise.m0 + np.array([[1e4], [0.0]]), case.noise.P0)
    assert find_outliers(case.model, case.recordings[1], noise, OutlierGate(), 0).dropped[0].any()
    assert not find_outliers(case.model, case.recordings[1], noise, OutlierGate(), 1).dropped[0].any()

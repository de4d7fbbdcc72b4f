"""Data and starts without a good answer: each ends in a sentence or a labelled status, never in NaN or a traceback."""

from dataclasses import replace

import numpy as np
import pytest
from pendulum import pendulum_case

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators import alg3, em
from noiseid_cli.estimators.data_check import check_data
from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.estimators.unknowns import Unknowns
from noiseid_cli.models.linear import linear_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording

LEVEL = linear_model([[1.0]], [[1.0]], [[1.0]])
WALK = np.cumsum(np.random.default_rng(0).normal(size=200)) + np.random.default_rng(1).normal(size=200)


def recording(y):
    y = np.asarray(y, dtype=float).reshape(-1, 1)
    return Recording("t", np.ones(max(len(y) - 1, 0)), np.zeros((len(y), 0)), y)


def fitted(y, q=1.0, r=1.0, p=1.0):
    start = NoiseValues(np.eye(1) * q, np.eye(1) * r, np.zeros((1, 1)), np.eye(1) * p)
    unknowns = Unknowns(Q=CovarianceStructure.full(start.Q, "Q"), R=CovarianceStructure.diagonal(start.R, "R"))
    return em.estimate(LEVEL, [recording(y)], start, unknowns, em.EmOptions(max_passes=100))


@pytest.mark.parametrize(
    ("y", "text"),
    [
        ([], "at least one"),
        ([1.0], "no test has two samples"),
        ([np.nan] * 20, "nothing was measured"),
        ([1.0, np.inf, 2.0], "sample 2: an output is not a usable number"),
    ],
)
def test_data_without_an_answer_are_refused(y, text):
    with pytest.raises(EstimationError, match=text):
        fitted(y)


@pytest.mark.parametrize(
    ("y", "start"),
    [([1.0] * 50, {}), ([0.0] * 50, {}), (WALK * 1e-160, {})],
    ids=["constant", "zero", "tiny"],
)
def test_a_variance_that_vanishes_is_a_labelled_end(y, start):
    result = fitted(y, **start)
    assert result.status == "stalled_fixed_point"
    assert "1e-10 of its start" in result.reason
    assert np.isfinite(result.loglik)
    assert np.all(np.isfinite(result.final.Q))


@pytest.mark.parametrize("start", [{"q": 1e-300}, {"q": 1e-30}, {"q": 1e-12}])
def test_a_start_that_is_as_good_as_zero_is_no_answer(start):
    """EM leaves it alone, which looks like rest; the likelihood of a greater one tells."""
    result = fitted(WALK, **start)
    assert result.status == "stalled_fixed_point"
    assert "has the greater likelihood" in result.reason
    assert result.loglik < fitted(WALK).loglik


def test_extreme_scales_and_priors_leave_the_answer_alone():
    usual = fitted(WALK)
    huge = fitted(WALK * 1e150, q=1e300, r=1e300, p=1e300)
    assert huge.status == usual.status == "converged"
    assert np.isclose(huge.final.Q[0, 0] / 1e300, usual.final.Q[0, 0], rtol=1e-6)
    assert fitted(WALK, p=1e16).status == fitted(WALK, p=0.0).status == "converged"


def test_an_outlier_ends_with_numbers():
    y = WALK.copy()
    y[50] = 1e8
    result = fitted(y)
    assert np.isfinite(result.loglik)
    assert result.final.R[0, 0] > 1e12


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"u": np.zeros((40, 2))}, "the inputs have the shape"),
        ({"y": np.zeros((40, 3))}, "the outputs have the shape"),
        ({"dt": np.ones(40)}, "one interval less"),
        ({"u": np.full((40, 1), np.nan)}, "sample 1: an input is not a usable number"),
        ({"dt": np.r_[np.ones(20), 0.0, np.ones(18)]}, "sample 21: the interval after"),
    ],
)
def test_recordings_that_do_not_fit_are_named(change, text):
    model, _, (good,) = pendulum_case(1)
    with pytest.raises(EstimationError, match=f"test 'test-0'.*{text}"):
        check_data(model, [good, replace(good, **change)][1:])


def test_no_tests_at_all():
    with pytest.raises(EstimationError, match="no test"):
        check_data(LEVEL, [])


def test_one_sample_is_enough_where_the_process_noise_is_known():
    check_data(LEVEL, [recording([1.0])], steps_needed=False)


def test_alg3_refuses_such_data_too():
    start = NoiseValues(np.eye(1), np.eye(1), np.zeros((1, 1)), np.eye(1))
    with pytest.raises(EstimationError, match="nothing was measured"):
        alg3.estimate(LEVEL, [recording([np.nan] * 9)], start, Unknowns(Q=CovarianceStructure.full(start.Q)))

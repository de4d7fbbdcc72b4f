"""Sigma points: their moments are those that they stand for."""

import math

import numpy as np
import pytest

from noiseid_cli.errors import EstimationError
from noiseid_cli.filters.sigma_points import cubature, draw, unscented, weighted_mean


def points(weights, x, U):
    X = np.empty((2 * len(x) + 1, len(x)))
    draw(x, U, weights.eta, X)
    return X


@pytest.mark.parametrize(
    "weights", [unscented(3), unscented(3, 0.5, 0.0, 1.5), unscented(3, 1.0, 2.0, 0.0), cubature(3)]
)
def test_points_have_the_mean_and_covariance(weights):
    rng = np.random.default_rng(1)
    x, U = rng.normal(size=3), np.triu(rng.normal(size=(3, 3)))
    X = points(weights, x, U)
    mean = np.empty(3)
    weighted_mean(X, weights.outer, mean)
    w = np.full(7, weights.outer)
    w[0] = weights.cov0
    d = X - mean
    assert mean == pytest.approx(x, abs=1e-13)
    # Outer points are x +/- eta U: rounding of x is amplified by 1 / eta.
    assert d.T @ (w[:, None] * d) == pytest.approx(U.T @ U, abs=1e-14 / weights.eta + 1e-13)
    assert weights.mean0 + 6 * weights.outer == pytest.approx(1.0, abs=1e-9 / weights.eta)


def test_weights_of_the_paper_in_numbers():
    # alpha = .08, beta = 2, kappa = 3 - n, n = 2: lambda_f = .0064 * 3 - 2.
    w = unscented(2, 0.08, 2.0)
    assert w.eta == pytest.approx(math.sqrt(0.0192))
    assert w.mean0 == pytest.approx(-1.9808 / 0.0192)
    assert w.cov0 == pytest.approx(-1.9808 / 0.0192 + 1 - 0.0064 + 2)
    assert w.outer == pytest.approx(1 / 0.0384)


def test_mean_of_a_square_is_exact():
    for w in (unscented(2, 0.3, 2.0, 1.0), cubature(2)):
        U = np.array([[0.5, 0.2], [0.0, 0.7]])
        Y = np.square(points(w, np.array([1.0, -2.0]), U))
        mean = np.empty(2)
        weighted_mean(Y, w.outer, mean)
        assert mean == pytest.approx(np.array([1.0, 4.0]) + np.diag(U.T @ U), rel=1e-13)


@pytest.mark.parametrize("arguments", [(0.0, 2.0, 1.0), (math.nan, 2.0, 1.0), (0.5, 2.0, -2.0), (0.5, 2.0, math.inf)])
def test_spreads_that_give_no_points_are_refused(arguments):
    with pytest.raises(EstimationError, match="above"):
        unscented(2, *arguments)

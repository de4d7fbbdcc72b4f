"""Rank-one changes of factors, and the derivative of a factor."""

import numpy as np
import pytest
from kronecker_factor import kronecker_derivative

from noiseid_cli.filters.factors import downdate, factor_derivative, take_away, weighted_rank_one


def random_factor(seed, n):
    rng = np.random.default_rng(seed)
    U = np.triu(rng.normal(size=(n, n)))
    return rng, np.triu(U, 1) + np.diag(0.5 + np.abs(np.diag(U)))


@pytest.mark.parametrize("n", [1, 3, 6])
@pytest.mark.parametrize("weight", [0.7, -0.2])
def test_rank_one_change(n, weight):
    rng, U = random_factor(n, n)
    v = U.T @ rng.normal(size=n) / np.sqrt(n)
    new = U.copy()
    v[-1] += 0.1
    expected = U.T @ U + weight * np.outer(v, v)
    assert np.linalg.eigvalsh(expected)[0] > 0
    assert weighted_rank_one(new, n, v.copy(), weight, np.empty(n))
    assert new.T @ new == pytest.approx(expected, rel=1e-12, abs=1e-13)
    assert np.all(np.diag(new) > 0)
    assert np.array_equal(new, np.triu(new))


def test_update_then_downdate_comes_back():
    rng, U = random_factor(4, 5)
    v, new, scratch = rng.normal(size=5), U.copy(), np.empty(5)
    weighted_rank_one(new, 5, v.copy(), 2.0, scratch)
    weighted_rank_one(new, 5, v.copy(), -2.0, scratch)
    assert new == pytest.approx(U, abs=1e-12)


@pytest.mark.parametrize("excess", [1.0, 1.5])
def test_impossible_downdate_is_reported_and_changes_nothing(excess):
    rng, U = random_factor(2, 4)
    a = rng.normal(size=4)
    v = U.T @ (a / np.linalg.norm(a)) * np.sqrt(excess) * (1 + 1e-12)
    new = U.copy()
    assert not weighted_rank_one(new, 4, v, -1.0, np.empty(4))
    assert np.array_equal(new, U)


def test_only_the_leading_part_is_touched():
    rng, U = random_factor(3, 4)
    new = U.copy()
    assert weighted_rank_one(new, 2, rng.normal(size=4), 1.0, np.empty(4))
    assert np.array_equal(new[2:], U[2:])
    assert np.array_equal(new[:, 2:], U[:, 2:])
    assert not np.array_equal(new, U)


@pytest.mark.parametrize("n", [1, 2, 4, 6])
def test_factor_derivative_equals_the_kronecker_form(n):
    rng, U = random_factor(10 + n, n)
    dP = rng.normal(size=(n, n))
    dP = dP + dP.T
    dU = np.empty((n, n))
    factor_derivative(U, dP, dU, np.empty((n, n)))
    assert dU == pytest.approx(kronecker_derivative(U.T, dP).T, rel=1e-12, abs=1e-12)
    assert dU.T @ U + U.T @ dU == pytest.approx(dP, rel=1e-12, abs=1e-12)


def test_factor_derivative_is_the_slope_of_cholesky():
    rng, U = random_factor(8, 3)
    dP = rng.normal(size=(3, 3))
    dP = dP + dP.T
    dU, h = np.empty((3, 3)), 1e-6
    factor_derivative(U, dP, dU, np.empty((3, 3)))
    P = U.T @ U
    slope = (np.linalg.cholesky(P + h * dP) - np.linalg.cholesky(P - h * dP)).T / (2 * h)
    assert dU == pytest.approx(slope, abs=1e-8)


@pytest.mark.parametrize("seed", range(4))
def test_columns_are_taken_away_one_after_the_other(seed):
    n, q = 5, 1 + seed
    rng, U = random_factor(seed, n)
    B = rng.normal(size=(n, q))
    B *= 0.99 / np.linalg.norm(B, 2)
    new, whole = U.copy(), np.column_stack([B, np.full(n, np.nan)])
    assert take_away(new, whole, q, 1e-8, np.empty(n), np.empty(n))
    # The smallest eigenvalue of I - BB' is 0.02, by whose inverse rounding grows.
    assert new.T @ new == pytest.approx(U.T @ (np.eye(n) - B @ B.T) @ U, rel=1e-12, abs=1e-12)
    assert np.array_equal(new, np.triu(new))
    assert (np.diag(new) > 0.0).all()
    one_by_one = U.copy()
    for v in (U.T @ B).T:
        assert downdate(one_by_one, n, v.copy(), 1e-8, np.empty(n))
    assert new == pytest.approx(one_by_one, rel=1e-11, abs=1e-12)


def test_too_much_taken_away_is_told_at_the_column_that_does_it():
    U, c, v = np.eye(2), np.empty(2), np.empty(2)
    assert take_away(U.copy(), np.array([[0.9], [0.0]]), 1, 0.1, c, v)
    assert not take_away(U.copy(), np.array([[0.9], [0.0]]), 1, 0.2, c, v)
    twice = np.array([[0.8, 0.8], [0.0, 0.0]])
    assert take_away(U.copy(), twice.copy(), 1, 0.0, c, v)
    assert not take_away(U.copy(), twice.copy(), 2, 0.0, c, v)

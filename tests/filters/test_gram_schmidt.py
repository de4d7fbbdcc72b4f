"""The upper factor of a stack held by columns, against reflections and in the corners."""

import numpy as np
import pytest

from noiseid_cli.filters.gram_schmidt import upper_of_columns, width
from noiseid_cli.filters.linalg import triangularise

EPS = np.finfo(float).eps


def factor(rows, columns=None):
    """The factor of the first columns of a stack of rows."""
    count, m = len(rows), rows.shape[1] if columns is None else columns
    A = np.full((rows.shape[1], width(count)), np.nan)
    A[:, :count] = rows.T
    U = np.full((rows.shape[1], rows.shape[1]), np.nan)
    upper_of_columns(A, m, count, U)
    return U[:m, :m]


@pytest.mark.parametrize("shape", [(1, 1), (3, 3), (4, 2), (13, 4), (21, 8), (2, 5)])
def test_it_is_the_factor_that_reflections_give(shape):
    rows = np.random.default_rng(sum(shape)).normal(size=shape) * 10.0 ** np.arange(-3, shape[1] - 3)
    W = rows.copy()
    triangularise(W, *shape, shape[1])
    full = np.zeros((shape[1], shape[1]))
    full[: shape[0]] = W[: shape[1]]
    U, lengths = factor(rows), np.linalg.norm(rows, axis=0)
    assert np.array_equal(U, np.triu(U))
    assert (np.diag(U) >= 0.0).all()
    assert (U / lengths).T @ (U / lengths) == pytest.approx((rows / lengths).T @ (rows / lengths), abs=60 * EPS)
    if shape[0] >= shape[1]:
        assert np.abs((U - full) / lengths).max() < 1e-12


def test_each_column_is_exact_in_its_own_unit_whatever_the_condition():
    rng = np.random.default_rng(3)
    rows = rng.normal(size=(12, 5)) * 10.0 ** np.array([0, -140, 100, -9, 5])
    rows[:, 1] = 1e-140 * rows[:, 0] + 1e-148 * rng.normal(size=12)
    U, lengths = factor(rows), np.linalg.norm(rows, axis=0)
    product = (U / lengths).T @ (U / lengths)
    assert product == pytest.approx((rows / lengths).T @ (rows / lengths), abs=60 * EPS)


def test_columns_of_zeros_and_sums_of_others():
    rows = np.array([[2.0, 0.0, 4.0, 1.0], [0.0, 0.0, 0.0, 3.0]])
    assert np.array_equal(factor(rows), [[2, 0, 4, 1], [0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 3]])
    assert np.array_equal(factor(rows, 3), [[2, 0, 4], [0, 0, 0], [0, 0, 0]])


def test_what_is_no_number_or_overflows_gives_nan():
    assert np.isnan(factor(np.array([[1e200], [1e200]]))[0, 0])
    U = factor(np.array([[1.0, np.nan], [1.0, 1.0]]))
    assert U[0, 0] == pytest.approx(2.0**0.5)
    assert np.isnan(U[1, 1])

"""Small dense linear algebra against NumPy, at widths on both sides of a block of eight."""

import numpy as np
import pytest
from numba import types

from noiseid_cli.filters.linalg import back_substitute, echelon, left_solve, products, triangularise, upper_times
from noiseid_cli.models.jit import kernel
from noiseid_cli.models.signatures import matrix

Index = types.int64[::1]


@kernel(types.void(matrix, types.int64))
def triangle(A, pivots):
    triangularise(A, A.shape[0], A.shape[1], pivots)


@kernel(types.int64(matrix, types.int64, Index))
def steps(A, pivots, pivot_column):
    return echelon(A, A.shape[0], A.shape[1], pivots, pivot_column)


@kernel(types.boolean(matrix, types.int64, Index))
def solve(A, p, pivot_column):
    return left_solve(A, p, A.shape[1], pivot_column)


@kernel(types.void(matrix, types.int64, Index, types.int64))
def substitute(A, rank, pivot_column, first):
    back_substitute(A, rank, pivot_column, first, A.shape[1])


@kernel(types.void(matrix, matrix, matrix, types.int64))
def times_upper(U, B, W, row):
    upper_times(U, B, W, row)


@kernel(types.void(matrix, types.int64, matrix))
def gram(W, rows, M):
    products(W, rows, M)


@pytest.mark.parametrize("columns", [1, 5, 7, 8, 9, 13, 16, 20, 24])
@pytest.mark.parametrize("rows", [1, 4, 12])
@pytest.mark.parametrize("pivots", [1, 4, 8])
def test_a_triangle_keeps_the_products(rows, columns, pivots):
    pivots = min(pivots, columns)
    A = np.random.default_rng(rows * columns).normal(size=(rows, columns))
    T = A.copy()
    triangle(T, pivots)
    # Backward stability (Higham, Accuracy and Stability, 19.3): errors of some rows x pivots roundings of the columns.
    lengths = np.linalg.norm(A, axis=0)
    assert np.all(np.abs(T.T @ T - A.T @ A) <= 8 * (rows + pivots) * 2.3e-16 * np.outer(lengths, lengths))
    for j in range(pivots):
        assert not T[j + 1 :, j].any()
        assert j >= rows or T[j, j] >= 0.0


def test_a_column_does_not_depend_on_how_many_are_worked_on():
    A = np.random.default_rng(5).normal(size=(9, 19))
    wide, narrow = A.copy(), A[:, :11].copy()
    triangle(wide, 8)
    triangle(narrow, 8)
    np.testing.assert_array_equal(wide[:, :11], narrow)  # in a block or in the loop after the last one


def test_dependent_columns_take_no_row():
    A = np.random.default_rng(2).normal(size=(7, 10))
    A[:, 2] = A[:, 0] - 2.0 * A[:, 1]
    A[:, 4] = 0.0
    T, pivot_column = A.copy(), np.zeros(6, dtype=np.int64)
    assert steps(T, 6, pivot_column) == 4
    assert pivot_column[:4].tolist() == [0, 1, 3, 5]
    np.testing.assert_allclose(T.T @ T, A.T @ A, rtol=0, atol=1e-13)
    for row, column in enumerate(pivot_column[:4]):
        assert not T[row, :column].any()
    assert not T[4:, :6].any()


@pytest.mark.parametrize("others", [1, 3, 8, 12])
@pytest.mark.parametrize("p", [1, 3, 8])
def test_least_squares(p, others):
    generator = np.random.default_rng(p * others)
    A = generator.normal(size=(9, p + others))
    S = A.copy()
    assert solve(S, p, np.zeros(p, dtype=np.int64))
    expected = np.linalg.lstsq(A[:, :p], A[:, p:], rcond=None)[0]
    np.testing.assert_allclose(S[:p, p:], expected, rtol=1e-11, atol=1e-12)
    A[:, p - 1] = A[:, : p - 1].sum(axis=1)
    assert not solve(A, p, np.zeros(p, dtype=np.int64))


def test_back_substitution_over_pivot_columns():
    A = np.triu(np.random.default_rng(3).normal(size=(3, 14)))
    pivot_column = np.array([0, 1, 3])
    A[2, 2] = 0.0  # column 2 depends on the two before it
    expected = np.linalg.solve(A[:, pivot_column], A[:, 4:])
    substitute(A, 3, pivot_column, 4)
    np.testing.assert_allclose(A[:, 4:], expected, rtol=1e-11)


@pytest.mark.parametrize("columns", [8, 16])
def test_products_of_blocks(columns):
    generator = np.random.default_rng(columns)
    U, B, W = np.triu(generator.normal(size=(5, 5))), generator.normal(size=(5, columns)), np.zeros((7, columns))
    times_upper(U, B, W, 2)
    np.testing.assert_allclose(W[2:], U @ B, rtol=0, atol=1e-14)
    assert not W[:2].any()
    M = np.empty((columns - 3, columns))
    gram(W, 6, M)
    np.testing.assert_allclose(M, (W[:6].T @ W[:6])[: columns - 3], rtol=0, atol=1e-14)

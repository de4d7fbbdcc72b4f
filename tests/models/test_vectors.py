"""Blocks of eight columns against NumPy, at every width around them, and that nothing is written beyond an array."""

import numpy as np
import pytest
from numba import types

from noiseid_cli.models.jit import kernel
from noiseid_cli.models.signatures import matrix
from noiseid_cli.models.vectors import blocks, clear, load, plus, rows_in, rows_out, store, times, zeros


@kernel(types.void(matrix, matrix, types.float64, types.float64))
def combine(A, B, a, b):
    for r in range(A.shape[0]):
        store(B, r, 0, plus(times(a, load(A, r, 0)), b, load(B, r, 0)))
        store(A, r, 0, zeros())


@kernel(types.void(matrix, types.int64, types.int64, matrix))
def out_of(W, row, column, A):
    rows_out(W, row, column, A)


@kernel(types.void(matrix, matrix, types.int64))
def into(A, W, row):
    rows_in(A, W, row)


@kernel(types.void(matrix, types.int64, types.int64))
def clear_row(W, row, column):
    clear(W, row, column)


@kernel(types.int64(types.int64))
def room(columns):
    return blocks(columns)


def guarded(shape):
    """An array in the middle of a larger one, whose ends tell whether somebody wrote there."""
    size = shape[0] * shape[1]
    memory = np.full(size + 32, -7.0)
    return memory, memory[16 : 16 + size].reshape(shape)


def untouched(memory):
    return np.all(memory[:16] == -7.0) and np.all(memory[-16:] == -7.0)


def test_arithmetic_of_blocks_is_that_of_numbers():
    generator = np.random.default_rng(1)
    A, B = generator.normal(size=(3, 8)), generator.normal(size=(3, 8))
    expected = 0.3 * A + -1.7 * B
    combine(A, B, 0.3, -1.7)
    np.testing.assert_array_equal(B, expected)  # no product is fused with a sum
    assert not A.any()


@pytest.mark.parametrize("width", range(1, 19))
@pytest.mark.parametrize("rows", [1, 2, 5])
def test_rows_come_out_whole_and_nothing_beyond(width, rows):
    W = np.random.default_rng(width).normal(size=(rows + 2, 32))
    memory, A = guarded((rows, width))
    out_of(W, 2, 3, A)
    np.testing.assert_array_equal(A, W[2:, 3 : 3 + width])
    assert untouched(memory)


@pytest.mark.parametrize("width", range(1, 19))
@pytest.mark.parametrize("rows", [1, 2, 5])
def test_rows_go_in_whole_and_nothing_beyond(width, rows):
    memory, W = guarded((rows + 1, -(-width // 8) * 8))
    W[:] = 0.0
    A = np.random.default_rng(width).normal(size=(rows, width))
    into(A, W, 1)
    np.testing.assert_array_equal(W[1:, :width], A)
    assert not W[0].any()
    assert untouched(memory)


@pytest.mark.parametrize("width", [1, 7, 8, 9, 16, 21])
@pytest.mark.parametrize("column", [0, 3, 8])
def test_the_rest_of_a_row_is_cleared(width, column):
    memory, W = guarded((3, width))
    W[:] = 1.0
    clear_row(W, 1, column)
    assert np.all(W[1, :column] == 1.0)
    assert not W[1, column:].any()
    assert np.all(W[[0, 2]] == 1.0)
    assert untouched(memory)


def test_blocks_are_the_least_that_hold_the_columns():
    assert [room(c) for c in (0, 1, 7, 8, 9, 16, 17)] == [0, 8, 8, 8, 16, 16, 24]

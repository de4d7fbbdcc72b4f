"""The upper factor of a stack of rows, of which nothing but the factor is wanted.

Modified Gram-Schmidt gives the triangle as exactly as reflections do (Bjorck, BIT 7, 1967; Higham, Accuracy and
Stability of Numerical Algorithms, Theorem 19.13). The stack is held column by column: sums run along memory, four at a
time, which for a dozen rows takes a third of the time that ``linalg.triangularise`` does.
"""

from __future__ import annotations

import math

import numpy as np

from noiseid_cli.models.jit import routine

FOUR = np.uint64(4)


def width(rows: int) -> int:
    """Length of a column of ``rows`` rows in memory: the next multiple of four."""
    return -(-rows // 4) * 4


@routine
def _dot(A, j, k, end):  # type: ignore[no-untyped-def]
    """Sum over A[j, :end] A[k, :end], in four sums that do not wait for each other; ``end`` is a multiple of four."""
    a = b = c = d = 0.0
    for i in range(np.uint64(0), end, FOUR):
        a += A[j, i] * A[k, i]
        b += A[j, i + np.uint64(1)] * A[k, i + np.uint64(1)]
        c += A[j, i + np.uint64(2)] * A[k, i + np.uint64(2)]
        d += A[j, i + np.uint64(3)] * A[k, i + np.uint64(3)]
    return (a + b) + (c + d)


@routine
def upper_of_columns(A, m, rows, U):  # type: ignore[no-untyped-def]
    """U'U = A A': the upper factor of the covariance whose factor rows are the columns of A.

    Args:
        A: (>= m, >= width(rows)), overwritten; A[j, :rows] is column j of the stack.
        m, rows: the part of A that is worked on.
        U: (>= m, >= m), written: upper, non-negative diagonal, zeros below; a row of zeros where a column is exactly
            a sum of those before it. Squares that overflow give NaN.
    """
    m, end, one = np.uint64(m), np.uint64(rows), np.uint64(1)
    padded = (end + np.uint64(3)) // FOUR * FOUR
    for j in range(m):
        for i in range(end, padded):
            A[j, i] = 0.0
    for j in range(m):
        for k in range(m):
            U[j, k] = 0.0
        length = math.sqrt(_dot(A, j, j, padded))
        if length == 0.0:
            continue
        U[j, j] = length if length < math.inf else math.nan
        scale = 1.0 / length
        for k in range(j + one, m):
            U[j, k] = scale * _dot(A, j, k, padded)
            share = scale * U[j, k]
            for i in range(padded):
                A[k, i] -= share * A[j, i]

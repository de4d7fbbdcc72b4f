"""When the covariances of a recursion have come to rest, so that they need not be computed anew.

A constant model seen at equal intervals, with the same outputs measured, has covariances that converge. Rounding keeps
the last digits of a factor in motion for ever, so rest is asked to rounding: a factor is at rest if it is what it was
half of the equal steps ago. Geometric convergence has then long passed below rounding, and a slow one is not taken for
rest, since half of the way is never little of it.
"""

from __future__ import annotations

import numpy as np

from noiseid_cli.filters.linalg import EPS
from noiseid_cli.models.arrays import copy_matrix
from noiseid_cli.models.jit import routine

FIRST = 8
"""Equal steps after which a factor is first remembered [chosen]; then at 12, 16, 24, 32, 48 and on."""


@routine
def same(A, B):  # type: ignore[no-untyped-def]
    """Whether two matrices are equal to the last bit."""
    columns = np.uint64(A.shape[1])
    for i in range(np.uint64(A.shape[0])):
        different = 0
        for j in range(columns):
            different += A[i, j] != B[i, j]
        if different > 0:
            return False
    return True


@routine
def at_rest(U, rows, before, alike):  # type: ignore[no-untyped-def]
    """Whether the upper factor U is what it was half of the equal steps ago, to rounding.

    The measure of rounding is that of ``linalg.echelon``: 4 rows eps of a column's length.

    Args:
        U: (n, n); rows: of the matrix whose triangularisation gave U.
        before: (2, n, n), U as it was at the last 2^j and 3 2^j equal steps; written where a comparison is due.
        alike: number of equal steps up to U.
    """
    chain = 0 if alike % 3 != 0 else 1
    power = alike // 3 if chain == 1 else alike
    if alike < FIRST or power & (power - 1) != 0:
        return False
    rests = alike >= 2 * FIRST
    n = U.shape[0]
    for c in range(n):
        length, change = 0.0, 0.0
        for r in range(c + 1):
            length += U[r, c] * U[r, c]
            change += (U[r, c] - before[chain, r, c]) ** 2
        if not change <= (4.0 * rows * EPS) ** 2 * length:
            rests = False
    copy_matrix(U, before[chain])
    return rests

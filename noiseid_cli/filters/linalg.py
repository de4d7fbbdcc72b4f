"""Small dense linear algebra for the kernels, in square-root form.

Factors are kept as upper triangles U with P = U'U, the transpose of the chol_P of the public results: rows of U
are independent unit noises, so that stacking rows adds covariances and one orthogonal triangularisation of the
stack gives the factor of the sum. Nothing is ever subtracted, nothing is added to a diagonal.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from noiseid_cli.errors import EstimationError
from noiseid_cli.models.jit import routine
from noiseid_cli.models.vectors import EIGHT, load, plus, store, times

EPS = float(np.finfo(float).eps)


@routine
def reflect(A, r, j, rows, columns):  # type: ignore[no-untyped-def]
    """Reflect rows r and below of A so that column j would be zero below row r, and non-negative at it.

    Columns j + 1 and on are carried along (Golub & Van Loan, Matrix Computations, 5.1; the sign rule is Parlett's).
    What stands before column j + 1 in the rows below r is of no use any more, and holds whatever the blocks leave.
    """
    # Of unsigned indices numba knows that they do not count from the end: the loops become twice as fast.
    r, j, end, width, one = np.uint64(r), np.uint64(j), np.uint64(rows), np.uint64(columns), np.uint64(1)
    below = 0.0
    for i in range(r + one, end):
        below += A[i, j] * A[i, j]
    pivot = A[r, j]
    if below == 0.0:
        if pivot < 0.0:
            for k in range(j, width):
                A[r, k] = -A[r, k]
        return
    norm = math.sqrt(pivot * pivot + below)
    v0 = pivot - norm if pivot <= 0.0 else -below / (pivot + norm)
    tau = 2.0 * v0 * v0 / (below + v0 * v0)
    scale = 1.0 / v0
    first, whole = j // EIGHT, width // EIGHT
    for k in range(max(whole * EIGHT, j + one), width):
        total = A[r, k]
        for i in range(r + one, end):
            if A[i, j] != 0.0:
                total += scale * A[i, j] * A[i, k]
        total *= tau
        A[r, k] -= total
        for i in range(r + one, end):
            if A[i, j] != 0.0:
                A[i, k] -= scale * A[i, j] * total
    # The block of column j comes last: it overwrites what makes the reflection.
    for back in range(first, whole):
        c = (first + whole - one - back) * EIGHT
        sums = load(A, r, c)
        for i in range(r + one, end):
            sums = plus(sums, scale * A[i, j], load(A, i, c))
        sums = times(tau, sums)
        store(A, r, c, plus(load(A, r, c), -1.0, sums))
        for i in range(r + one, end):
            factor = -scale * A[i, j]
            store(A, i, c, plus(load(A, i, c), factor, sums))
    A[r, j] = norm


@routine
def transpose(A, B):  # type: ignore[no-untyped-def]
    """Write A' of A (m, n) to the first columns of B (n, >= m)."""
    for r in range(np.uint64(A.shape[0])):
        for c in range(np.uint64(A.shape[1])):
            B[c, r] = A[r, c]


@routine
def upper_times(U, B, W, row):  # type: ignore[no-untyped-def]
    """Write U B, of an upper triangle U (n, n) and B (n, blocks), to the first columns of W, from ``row`` on."""
    n, row = np.uint64(U.shape[0]), np.uint64(row)
    for block in range(np.uint64(B.shape[1]) // EIGHT):
        c = block * EIGHT
        for r in range(n):
            sums = times(U[r, r], load(B, r, c))
            for j in range(r + np.uint64(1), n):
                sums = plus(sums, U[r, j], load(B, j, c))
            store(W, row + r, c, sums)


@routine
def products(W, rows, M):  # type: ignore[no-untyped-def]
    """Write W'W of the first ``rows`` rows of W (>= rows, blocks) to M (p, blocks), for the first p columns of W."""
    for block in range(np.uint64(M.shape[1]) // EIGHT):
        c = block * EIGHT
        for i in range(np.uint64(M.shape[0])):
            sums = times(W[0, i], load(W, 0, c))
            for r in range(np.uint64(1), np.uint64(rows)):
                sums = plus(sums, W[r, i], load(W, r, c))
            store(M, i, c, sums)


@routine
def triangularise(A, rows, columns, pivots):  # type: ignore[no-untyped-def]
    """Bring the first ``pivots`` columns of A[:rows, :columns] to upper-triangular form by reflections from the left.

    A'A stays as it is. Diagonal entries come out non-negative, entries below them exactly zero. Columns beyond
    ``pivots`` are carried along.

    Args:
        A: (>= rows, >= columns), overwritten.
        rows, columns, pivots: the part of A that is worked on; quickest where ``columns`` is a multiple of eight.
    """
    for j in range(min(rows, pivots)):
        reflect(A, j, j, rows, columns)
    for j in range(np.uint64(min(rows, pivots))):
        for i in range(j + np.uint64(1), np.uint64(rows)):
            A[i, j] = 0.0


@routine
def echelon(A, rows, columns, pivots, pivot_column):  # type: ignore[no-untyped-def]
    """Like ``triangularise``, but a column that depends on those before it takes no row: row-echelon form.

    A column is dependent if what is left of it is below 4 rows eps of its length, which is what rounding leaves; the
    rest is set to zero. Scaling a column (a change of units) does not change the decision.

    Args:
        A, rows, columns, pivots: as in ``triangularise``.
        pivot_column: (>= min(rows, pivots),), written: the column of each pivot.

    Returns:
        The rank of the first ``pivots`` columns.
    """
    rank = 0
    for j in range(pivots):
        above = 0.0
        left = 0.0
        for i in range(rank):
            above += A[i, j] * A[i, j]
        for i in range(rank, rows):
            left += A[i, j] * A[i, j]
        if rank < rows and not left <= (4.0 * rows * EPS) ** 2 * (above + left):
            reflect(A, rank, j, rows, columns)
            pivot_column[rank] = j
            rank += 1
    for i in range(np.uint64(rows)):
        for j in range(np.uint64(pivot_column[i] if i < rank else pivots)):
            A[i, j] = 0.0
    return rank


@routine
def back_substitute(A, rank, pivot_column, first, columns):  # type: ignore[no-untyped-def]
    """Solve for columns ``first`` and on of an echelon form, in place: A[:rank, first:] = A_p^-1 A[:rank, first:].

    A_p are the pivot columns, which stand before ``first``. What follows ``columns`` in A may be overwritten.
    """
    first, end, one = np.uint64(first), np.uint64(columns), np.uint64(1)
    whole = first + (np.uint64(A.shape[1]) - first) // EIGHT * EIGHT
    for back in range(rank):
        i = np.uint64(rank - 1 - back)
        scale = 1.0 / A[i, np.uint64(pivot_column[i])]
        c = first
        while c < end and c < whole:
            sums = load(A, i, c)
            for other in range(i + one, np.uint64(rank)):
                sums = plus(sums, -A[i, np.uint64(pivot_column[other])], load(A, other, c))
            store(A, i, c, times(scale, sums))
            c += EIGHT
        for k in range(c, end):
            total = A[i, k]
            for other in range(i + one, np.uint64(rank)):
                total -= A[i, np.uint64(pivot_column[other])] * A[other, k]
            A[i, k] = scale * total


@routine
def left_solve(A, p, columns, pivot_column):  # type: ignore[no-untyped-def]
    """Least squares, in place: A[:p, p:columns] = A_p^+ A[:, p:columns], A_p being the first p columns of A.

    Args:
        A: (n, >= columns), n >= p, overwritten.
        p, columns: the part of A that is worked on.
        pivot_column: scratch (p,).

    Returns:
        Whether the first p columns are independent, see ``echelon``; if not, there is no solution in A.
    """
    rank = echelon(A, A.shape[0], columns, p, pivot_column)
    if rank == p:
        back_substitute(A, p, pivot_column, p, columns)
    return rank == p


@routine
def add_products(W, rows, M):  # type: ignore[no-untyped-def]
    """Add W'W of the first ``rows`` rows of W to the symmetric matrix M (p, p)."""
    p = np.uint64(M.shape[0])
    for r in range(np.uint64(rows)):
        for i in range(p):
            a = W[r, i]
            for j in range(p):
                M[i, j] += a * W[r, j]


@routine
def forward_solve(U, q, x):  # type: ignore[no-untyped-def]
    """Replace x[:q] by U'^-1 x, U the leading (q, q) of an upper triangle."""
    for b in range(q):
        for c in range(b):
            x[b] -= U[c, b] * x[c]
        x[b] /= U[b, b]


@routine
def backward_solve(U, q, x):  # type: ignore[no-untyped-def]
    """Replace x[:q] by U^-1 x, U the leading (q, q) of an upper triangle; after ``forward_solve``: (U'U)^-1 x."""
    for b in range(q - 1, -1, -1):
        for c in range(b + 1, q):
            x[b] -= U[b, c] * x[c]
        x[b] /= U[b, b]


def upper_factor(P: NDArray[np.float64], what: str) -> NDArray[np.float64]:
    """Upper-triangular U with U'U = P, for a symmetric positive semidefinite P.

    Args:
        P: (n, n) covariance.
        what: its name, for the error's text.

    Raises:
        EstimationError: P is not symmetric, not finite or has a negative eigenvalue.
    """
    P = np.asarray(P, dtype=float)
    if not np.isfinite(P).all():
        raise EstimationError(f"{what} has entries that are not finite numbers")
    if (P != P.T).any() and np.abs(P - P.T).max() > 1e-12 * np.abs(P).max():
        raise EstimationError(f"{what} is not symmetric")
    try:
        return np.ascontiguousarray(np.linalg.cholesky(P).T)
    except np.linalg.LinAlgError:
        pass
    # Semidefinite: the eigenvalues tell rounding of a zero from a truly negative direction.
    values, vectors = np.linalg.eigh(P)
    # A covariance is often a product of two factors, which brings in a few roundings of each sum.
    if values[0] < -8 * len(P) * np.finfo(float).eps * max(values[-1], 0.0) or values[-1] < 0.0:
        raise EstimationError(f"{what} is not positive semidefinite: its smallest eigenvalue is {values[0]:.3g}")
    rows = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    U = np.ascontiguousarray(rows)
    triangularise(U, len(U), len(U), len(U))
    return U

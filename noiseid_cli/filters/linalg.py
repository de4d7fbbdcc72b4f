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

EPS = float(np.finfo(float).eps)


@routine
def reflect(A, r, j, rows, columns, w):  # type: ignore[no-untyped-def]
    """Reflect rows r and below of A so that column j is zero below row r and non-negative at it.

    Columns j + 1 and on are carried along (Golub & Van Loan, Matrix Computations, 5.1; the sign rule is Parlett's).
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
    for k in range(j + one, width):
        w[k] = A[r, k]
    for i in range(r + one, end):
        v = scale * A[i, j]
        A[i, j] = v
        if v != 0.0:
            for k in range(j + one, width):
                w[k] += v * A[i, k]
    A[r, j] = norm
    for k in range(j + one, width):
        w[k] *= tau
        A[r, k] -= w[k]
    for i in range(r + one, end):
        v = A[i, j]
        if v != 0.0:
            A[i, j] = 0.0
            for k in range(j + one, width):
                A[i, k] -= v * w[k]


@routine
def rows_of(U, A, first, count, W, row, column):  # type: ignore[no-untyped-def]
    """Write U A' to W from (row, column) on, for ``count`` rows of A from ``first`` on; U is upper-triangular."""
    n, first, row, column = np.uint64(U.shape[0]), np.uint64(first), np.uint64(row), np.uint64(column)
    for c in range(np.uint64(count)):
        for r in range(n):
            total = 0.0
            for j in range(r, n):
                total += U[r, j] * A[first + c, j]
            W[row + r, column + c] = total


@routine
def triangularise(A, rows, columns, pivots, w):  # type: ignore[no-untyped-def]
    """Bring the first ``pivots`` columns of A[:rows, :columns] to upper-triangular form by reflections from the left.

    A'A stays as it is. Diagonal entries come out non-negative, entries below them exactly zero. Columns beyond
    ``pivots`` are carried along.

    Args:
        A: (>= rows, >= columns), overwritten.
        rows, columns, pivots: the part of A that is worked on.
        w: scratch (>= columns,).
    """
    for j in range(min(rows, pivots)):
        reflect(A, j, j, rows, columns, w)


@routine
def echelon(A, rows, columns, pivots, pivot_column, w):  # type: ignore[no-untyped-def]
    """Like ``triangularise``, but a column that depends on those before it takes no row: row-echelon form.

    A column is dependent if what is left of it is below 4 rows eps of its length, which is what rounding leaves; the
    rest is set to zero. Scaling a column (a change of units) does not change the decision.

    Args:
        A, rows, columns, pivots, w: as in ``triangularise``.
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
        if left <= (4.0 * rows * EPS) ** 2 * (above + left):
            for i in range(rank, rows):
                A[i, j] = 0.0
            continue
        reflect(A, rank, j, rows, columns, w)
        pivot_column[rank] = j
        rank += 1
    return rank


@routine
def left_solve(A, p, columns, X, w):  # type: ignore[no-untyped-def]
    """Least squares: X[r] = (A_p^+ a_r)', A_p the first p columns of A and a_r the others.

    One triangularisation and back-substitution; a column of A_p is dependent on those before it if what is left of it
    is below 4 n eps of its length.

    Args:
        A: (n, >= columns), overwritten.
        p, columns: the part of A that is worked on.
        X: (>= columns - p, p), written.
        w: scratch (>= columns,).

    Returns:
        Whether the first p columns are independent; if not, X is not written.
    """
    n = A.shape[0]
    triangularise(A, n, columns, p, w)
    for i in range(p):
        length = 0.0
        for j in range(i + 1):
            length += A[j, i] * A[j, i]
        if A[i, i] <= 4.0 * n * EPS * math.sqrt(length):
            return False
    for r in range(columns - p):
        for i in range(p - 1, -1, -1):
            total = A[i, p + r]
            for j in range(i + 1, p):
                total -= A[i, j] * X[r, j]
            X[r, i] = total / A[i, i]
    return True


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
    if not np.all(np.isfinite(P)):
        raise EstimationError(f"{what} has entries that are not finite numbers")
    scale = float(np.max(np.abs(P), initial=0.0))
    if np.max(np.abs(P - P.T), initial=0.0) > 1e-12 * scale:
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
    triangularise(U, len(U), len(U), len(U), np.empty(len(U)))
    return U

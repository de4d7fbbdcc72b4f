"""Copies between arrays in compiled code.

For ``B[:] = A`` numba compiles the text of an error message, should the shapes differ: 3 s in each kernel. These loops
take a tenth of that, and as long as it when they run. Shapes must be equal.
"""

from __future__ import annotations

from noiseid_cli.models.jit import routine


@routine
def copy(a, out):  # type: ignore[no-untyped-def]
    """Write the vector a (n,) to out."""
    for i in range(a.shape[0]):
        out[i] = a[i]


@routine
def copy_matrix(A, out):  # type: ignore[no-untyped-def]
    """Write the matrix A (m, n) to out."""
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            out[i, j] = A[i, j]


@routine
def copy_cube(A, out):  # type: ignore[no-untyped-def]
    """Write A (l, m, n) to out."""
    for i in range(A.shape[0]):
        copy_matrix(A[i], out[i])

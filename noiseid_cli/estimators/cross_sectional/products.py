"""Products and factors of small matrices for the kernels; written out, since library calls cost more at these sizes."""

from __future__ import annotations

import math

from noiseid_cli.models.jit import routine


@routine
def add(s, A, B, out):  # type: ignore[no-untyped-def]
    """Add s A B to out."""
    for i in range(A.shape[0]):
        for r in range(A.shape[1]):
            a = s * A[i, r]
            for j in range(B.shape[1]):
                out[i, j] += a * B[r, j]


@routine
def add_t(s, A, B, out):  # type: ignore[no-untyped-def]
    """Add s A B' to out."""
    for i in range(A.shape[0]):
        for j in range(B.shape[0]):
            total = 0.0
            for r in range(A.shape[1]):
                total += A[i, r] * B[j, r]
            out[i, j] += s * total


@routine
def t_add(s, A, B, out):  # type: ignore[no-untyped-def]
    """Add s A' B to out."""
    for r in range(A.shape[0]):
        for i in range(A.shape[1]):
            a = s * A[r, i]
            for j in range(B.shape[1]):
                out[i, j] += a * B[r, j]


@routine
def cholesky(S, L):  # type: ignore[no-untyped-def]
    """Write the lower factor of S; return log det S, NaN if S is not positive definite."""
    logdet = 0.0
    for j in range(S.shape[0]):
        for i in range(j):
            L[i, j] = 0.0
        for i in range(j, S.shape[0]):
            total = S[i, j]
            for r in range(j):
                total -= L[i, r] * L[j, r]
            if i == j:
                if not total > 0.0 or not math.isfinite(total):
                    return math.nan
                L[j, j] = math.sqrt(total)
                logdet += 2.0 * math.log(L[j, j])
            else:
                L[i, j] = total / L[j, j]
    return logdet


@routine
def whiten(L, A):  # type: ignore[no-untyped-def]
    """Replace A by L^-1 A."""
    for i in range(L.shape[0]):
        for r in range(i):
            for c in range(A.shape[1]):
                A[i, c] -= L[i, r] * A[r, c]
        for c in range(A.shape[1]):
            A[i, c] /= L[i, i]


@routine
def unwhiten(L, A):  # type: ignore[no-untyped-def]
    """Replace A by L^-T A."""
    for i in range(L.shape[0] - 1, -1, -1):
        for r in range(i + 1, L.shape[0]):
            for c in range(A.shape[1]):
                A[i, c] -= L[r, i] * A[r, c]
        for c in range(A.shape[1]):
            A[i, c] /= L[i, i]

"""The matrix exponential and its integral, for the exact discretisation of linear equations."""

from __future__ import annotations

import math

import numpy as np

from noiseid_cli.models.arrays import copy_matrix
from noiseid_cli.models.jit import allocating, routine

# Terms of the series: at a norm of 1/2 the first one left out is 0.5^15 / 16! = 1e-18 of the sum.
_TERMS = 14


@routine
def held_exponential(A, dt, Phi, Psi, work):  # type: ignore[no-untyped-def]
    """Write Phi = exp(A dt) and Psi = integral of exp(A s) ds from 0 to dt.

    With x' = A x + c, c held over the interval, x(dt) = Phi x(0) + Psi c = x(0) + Psi (A x(0) + c).
    Scaling and doubling (Moler & Van Loan, SIAM Rev. 45, 2003, method 3): A is balanced, so that the units of the
    states do not matter, the interval halved until the norm is 1/2, Psi summed there, and both are doubled back.

    Args:
        A: (n, n), 1/s; dt: interval, s.
        Phi, Psi: (n, n), written; NaN where A dt is not finite.
        work: scratch (2 n n + n,).
    """
    n = A.shape[0]
    B = work[: n * n].reshape(n, n)
    T = work[n * n : 2 * n * n].reshape(n, n)
    d = work[2 * n * n : 2 * n * n + n]
    doublings = _halved(A, dt, B, d)
    if doublings < 0:
        Phi[:] = np.nan
        Psi[:] = np.nan
        return
    h = math.ldexp(dt, -doublings)
    for i in range(n):
        for j in range(n):
            Psi[i, j] = 1.0 if i == j else 0.0
    for k in range(_TERMS, 0, -1):
        _horner(B, Psi, k, T)
        copy_matrix(T, Psi)
    _product(B, Psi, Phi)
    for i in range(n):
        Phi[i, i] += 1.0
        for j in range(n):
            Psi[i, j] *= h
    for _ in range(doublings):
        _product(Phi, Psi, T)
        for i in range(n):
            for j in range(n):
                Psi[i, j] += T[i, j]
        _product(Phi, Phi, T)
        copy_matrix(T, Phi)
    for i in range(n):
        for j in range(n):
            Phi[i, j] *= d[i] / d[j]
            Psi[i, j] *= d[i] / d[j]


@routine
def _product(A, B, out):  # type: ignore[no-untyped-def]
    n = A.shape[0]
    for i in range(n):
        for j in range(n):
            out[i, j] = 0.0
        for k in range(n):
            a = A[i, k]
            if a != 0.0:
                for j in range(n):
                    out[i, j] += a * B[k, j]


@routine
def _horner(B, S, k, out):  # type: ignore[no-untyped-def]
    """Write I + B S / (k + 1): one term of Horner's rule for I + B/2! + B^2/3! + ..."""
    n = B.shape[0]
    _product(B, S, out)
    for i in range(n):
        for j in range(n):
            out[i, j] /= k + 1.0
        out[i, i] += 1.0


@routine
def _halved(A, dt, B, d):  # type: ignore[no-untyped-def]
    """Write B = D^-1 A D h, balanced, h = dt halved until the norm is 1/2; the number of halvings, -1 if not finite."""
    n = A.shape[0]
    _balanced(A, B, d)
    norm = 0.0
    for j in range(n):
        total = 0.0
        for i in range(n):
            total += abs(B[i, j])
        norm = max(norm, total * dt) if math.isfinite(total) else math.inf
    if not math.isfinite(norm):
        return -1
    doublings = max(0, math.frexp(norm)[1] + 1)
    h = math.ldexp(dt, -doublings)
    for i in range(n):
        for j in range(n):
            B[i, j] *= h
    return doublings


@routine
def _balanced(A, B, d):  # type: ignore[no-untyped-def]
    """Write B = D^-1 A D with rows and columns of like size, D = diag(d) of powers of two.

    Parlett & Reinsch, Numer. Math. 13, 1969; powers of two leave every digit as it is.
    """
    n = A.shape[0]
    copy_matrix(A, B)
    d[:] = 1.0
    moved = True
    rounds = 0
    while moved and rounds < 100:
        moved = False
        rounds += 1
        for i in range(n):
            column = 0.0
            row = 0.0
            for j in range(n):
                if j != i:
                    column += abs(B[j, i])
                    row += abs(B[i, j])
            if column == 0.0 or row == 0.0 or not math.isfinite(column) or not math.isfinite(row):
                continue
            f = 2.0 ** round(0.5 * math.log2(row / column))
            if column * f + row / f < 0.95 * (column + row):
                moved = True
                d[i] *= f
                for j in range(n):
                    B[j, i] *= f
                for j in range(n):
                    B[i, j] /= f


@allocating
def held_exponential_adjoint(A, dt, Phi_bar, Psi_bar, A_bar):  # type: ignore[no-untyped-def]
    """Write A_bar, the derivatives by A of  <Phi_bar, Phi> + <Psi_bar, Psi>: ``held_exponential`` in reverse.

    Args:
        A: (n, n), 1/s; dt: interval, s.
        Phi_bar, Psi_bar: weights (n, n); overwritten.
        A_bar: (n, n), written; NaN where A dt is not finite.
    """
    n = A.shape[0]
    B, T, d = np.empty((n, n)), np.empty((n, n)), np.empty(n)
    doublings = _halved(A, dt, B, d)
    if doublings < 0:
        A_bar[:] = np.nan
        return
    h = math.ldexp(dt, -doublings)
    # The way there, every matrix kept: S[k] after the term k of Horner's rule, then Phi and Psi before each doubling.
    S = np.empty((_TERMS + 2, n, n))
    Phi, Psi = np.empty((doublings + 1, n, n)), np.empty((doublings + 1, n, n))
    for i in range(n):
        for j in range(n):
            S[_TERMS + 1, i, j] = 1.0 if i == j else 0.0
    for k in range(_TERMS, 0, -1):
        _horner(B, S[k + 1], k, S[k])
    _product(B, S[1], Phi[0])
    for i in range(n):
        Phi[0, i, i] += 1.0
        for j in range(n):
            Psi[0, i, j] = h * S[1, i, j]
    for s in range(doublings):
        _product(Phi[s], Psi[s], T)
        for i in range(n):
            for j in range(n):
                Psi[s + 1, i, j] = Psi[s, i, j] + T[i, j]
        _product(Phi[s], Phi[s], Phi[s + 1])
    # And back.
    for i in range(n):
        for j in range(n):
            Phi_bar[i, j] *= d[i] / d[j]
            Psi_bar[i, j] *= d[i] / d[j]
    for s in range(doublings - 1, -1, -1):
        # Psi + Phi Psi and Phi Phi.
        T[:] = 0.0
        _add_product_t(Psi_bar, Psi[s], T)
        _add_product_t(Phi_bar, Phi[s], T)
        _add_t_product(Phi[s], Phi_bar, T)
        copy_matrix(Psi_bar, S[_TERMS + 1])
        _add_t_product(Phi[s], S[_TERMS + 1], Psi_bar)
        copy_matrix(T, Phi_bar)
    A_bar[:] = 0.0
    _add_product_t(Phi_bar, S[1], A_bar)
    for i in range(n):
        for j in range(n):
            Psi_bar[i, j] *= h
            S[_TERMS + 1, i, j] = 1.0 if i == j else 0.0
    _add_t_product(B, Phi_bar, Psi_bar)
    for k in range(1, _TERMS + 1):
        for i in range(n):
            for j in range(n):
                Psi_bar[i, j] /= k + 1.0
        _add_product_t(Psi_bar, S[k + 1], A_bar)
        T[:] = 0.0
        _add_t_product(B, Psi_bar, T)
        copy_matrix(T, Psi_bar)
    for i in range(n):
        for j in range(n):
            A_bar[i, j] *= h * d[j] / d[i]


@routine
def _add_product_t(A, B, out):  # type: ignore[no-untyped-def]
    """Add A B'."""
    n = A.shape[0]
    for i in range(n):
        for j in range(n):
            for k in range(n):
                out[i, j] += A[i, k] * B[j, k]


@routine
def _add_t_product(A, B, out):  # type: ignore[no-untyped-def]
    """Add A' B."""
    n = A.shape[0]
    for k in range(n):
        for i in range(n):
            a = A[k, i]
            for j in range(n):
                out[i, j] += a * B[k, j]

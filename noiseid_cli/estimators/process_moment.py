"""Second moment of the process noise given the data: what one step adds to the sum.

Rows are multiplied and added up: nothing is subtracted, so that the sum is symmetric and positive semidefinite.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from noiseid_cli.filters.linalg import left_solve, products, upper_times
from noiseid_cli.models.jit import allocating, routine
from noiseid_cli.models.vectors import EIGHT, blocks, clear, load, plus, store, times


class Scratch(NamedTuple):
    """What the steps work in; rows are as long as their blocks of eight."""

    A: Any  # (n, ...), [F2 I] and then its solution, for the states that noise enters
    entered: Any  # (n,), which these are
    L: Any  # (nv, n), F2^+
    Lt: Any  # (n, blocks(nv)), its transpose
    B: Any  # (n, blocks(nv)), (L J1)'
    W: Any  # (rows + n, blocks(nv)), factor rows of v_k
    P: Any  # (nv, blocks(nv)), their products: the spread
    v: Any  # (nv,), the mean of v_k
    pivot_column: Any  # (nv,)


@allocating
def scratch(n, nv, rows):  # type: ignore[no-untyped-def]
    """Make the scratch matrices."""
    columns = max(blocks(nv + n), nv + blocks(n))
    return Scratch(
        np.zeros((n, columns)), np.zeros(n, dtype=np.int64), np.zeros((nv, n)), np.zeros((n, blocks(nv))),
        np.zeros((n, blocks(nv))), np.zeros((rows + n, blocks(nv))), np.zeros((nv, blocks(nv))), np.zeros(nv),
        np.zeros(nv, dtype=np.int64),
    )  # fmt: skip


@routine
def add_moment(L, r, s, sum_v):  # type: ignore[no-untyped-def]
    """Add (L r)(L r)' of L (nv, n) and r (n,), and the spread, to sum_v."""
    nv, n = L.shape
    for c in range(nv):
        s.v[c] = 0.0
        for j in range(n):
            s.v[c] += L[c, j] * r[j]
    for c in range(nv):
        for d in range(nv):
            sum_v[c, d] += s.v[c] * s.v[d] + s.P[c, d]


@routine
def spread_filtered(n, joint, s):  # type: ignore[no-untyped-def]
    """Write Cov(v_k | y) under the filter's linearisation, the smoother's own posterior, as the spread.

    joint: (rows + n, >= n + nv) factor of (x_k, v_k), see ``smoother.carry_joint``.
    """
    for r in range(s.W.shape[0]):
        for c in range(s.P.shape[0]):
            s.W[r, c] = joint[r, n + c]
    products(s.W, s.W.shape[0], s.P)


@routine
def left_inverse(F2, s):  # type: ignore[no-untyped-def]
    """Write F2^+ (nv, n) to L; returns whether F2 (n, nv) has full column rank.

    States that no noise enters, such as the positions of a mechanism, take no part: their columns of L are zero.
    """
    n, nv = F2.shape
    rows = 0
    for i in range(n):
        size = 0.0
        for c in range(nv):
            size += abs(F2[i, c])
            s.A[rows, c] = F2[i, c]
        if size != 0.0:  # NaN is
            s.entered[rows] = i
            rows += 1
    if rows < nv:
        return False
    for i in range(rows):
        clear(s.A, i, nv)
        s.A[i, nv + i] = 1.0
    if not left_solve(s.A[:rows], nv, nv + rows, s.pivot_column):
        return False
    for c in range(nv):
        clear(s.L, c, 0)
    for i in range(n):
        clear(s.Lt, i, 0)
    for i in range(rows):
        for c in range(nv):
            s.L[c, s.entered[i]] = s.A[c, nv + i]
            s.Lt[s.entered[i], c] = s.A[c, nv + i]
    return True


@routine
def spread_smoothed(J1, U_next, joint, s):  # type: ignore[no-untyped-def]
    """Write L (-J1 I) P^xi (-J1 I)' L' of the paper's M-step, L = F2^+, as the spread.

    Rows of a factor of (x_{k+1}, x_k) are [0; U_next] and those of ``joint``, so that those of v_k are
    [0; U_next L'] - joint (L J1)'.

    Args:
        J1: (n, n); U_next: (n, n) smoothed factor at k + 1.
        joint: (rows + n, >= n), its first columns a factor of x_k, see ``smoother.carry_joint``.
        s: ``Scratch``, with L as ``left_inverse`` left it.
    """
    n, one = np.uint64(J1.shape[0]), np.uint64(1)
    count = np.uint64(s.W.shape[0])
    rows = count - n
    for block in range(np.uint64(s.Lt.shape[1]) // EIGHT):
        c = block * EIGHT
        for j in range(n):
            sums = times(-J1[0, j], load(s.Lt, 0, c))
            for i in range(one, n):
                sums = plus(sums, -J1[i, j], load(s.Lt, i, c))
            store(s.B, j, c, sums)
    for r in range(rows):
        clear(s.W, r, 0)
    upper_times(U_next, s.Lt, s.W, rows)
    for block in range(np.uint64(s.Lt.shape[1]) // EIGHT):
        c = block * EIGHT
        for r in range(count):
            sums = load(s.W, r, c)
            for j in range(n):
                sums = plus(sums, joint[r, j], load(s.B, j, c))
            store(s.W, r, c, sums)
    products(s.W, count, s.P)

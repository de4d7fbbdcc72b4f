"""Second moment of the measurement noise given the data: what one sample adds to the sum, completed where missing."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from noiseid_cli.filters.linalg import add_products, products, transpose, triangularise, upper_times
from noiseid_cli.models.jit import allocating, routine
from noiseid_cli.models.vectors import blocks


@routine
def _complete(UR, block, seen, E, rows, W, w):  # type: ignore[no-untyped-def]
    """Fill the missing outputs of one block of E by their expectation given the seen ones, under e ~ N(0, R).

    E has ``rows`` rows; as many rows as there are missing outputs are added, the factor of what stays open.
    Returns the new number of rows. ``block`` lists the outputs of the block, ``seen`` says which were measured.
    """
    ny = UR.shape[0]
    q = 0
    for i in block:
        if seen[i]:
            for r in range(ny):
                W[r, q] = UR[r, i]
            q += 1
    p = q
    for i in block:
        if not seen[i]:
            for r in range(ny):
                W[r, p] = UR[r, i]
            p += 1
    # [R_oo factor, its product with R_om; 0, factor of R_mm given o].
    triangularise(W, ny, p, p)
    for r in range(rows):
        for a in range(q):
            w[a] = 0.0
        a = 0
        for i in block:
            if seen[i]:
                w[a] = E[r, i]
                for b in range(a):
                    w[a] -= W[b, a] * w[b]
                w[a] /= W[a, a]
                a += 1
        c = q
        for i in block:
            if not seen[i]:
                E[r, i] = 0.0
                for a in range(q):
                    E[r, i] += w[a] * W[a, c]
                c += 1
    for r in range(q, p):
        for j in range(ny):
            E[rows, j] = 0.0
        c = q
        for i in block:
            if not seen[i]:
                E[rows, i] = W[r, c]
                c += 1
        rows += 1
    return rows


@routine
def add_sample(E, rows, seen, UR, block_of, block, sum_e, samples, W, w):  # type: ignore[no-untyped-def]
    """Complete E block by block and add its products to sum_e; a block without a measured output is left out.

    Args:
        E: (>= rows + ny, ny), factor rows of the errors of one sample, zero where an output is missing; overwritten.
        seen: (ny,) which outputs were measured; UR: (ny, ny) factor of R; block_of: (ny,) block of each output.
        block, W, w: scratch (ny,), (ny, ny), (ny,).
        sum_e, samples: updated, see ``Statistics``.
    """
    ny = UR.shape[0]
    for b in range(ny):
        size = 0
        count = 0
        for i in range(ny):
            if block_of[i] == b:
                block[size] = i
                size += 1
                count += 1 if seen[i] else 0
        if count == 0:
            continue
        for i in block[:size]:
            samples[i] += 1.0
        if count < size:
            rows = _complete(UR, block[:size], seen, E, rows, W, w)
    add_products(E, rows, sum_e)


class Scratch(NamedTuple):
    """What ``add_measured`` works in; rows are as long as their blocks of eight."""

    Ht: Any  # (n, blocks(ny)), H'
    E: Any  # (n + 1 + ny, blocks(ny)), factor rows of the errors
    P: Any  # (ny, blocks(ny)), their products: the spread
    W: Any  # (ny, ny)
    w: Any  # (ny,)
    seen: Any  # (ny,)
    block: Any  # (ny,)


@allocating
def scratch(n, ny):  # type: ignore[no-untyped-def]
    """Make the scratch matrices."""
    return Scratch(
        np.zeros((n, blocks(ny))), np.zeros((n + 1 + ny, blocks(ny))), np.zeros((ny, blocks(ny))),
        np.empty((ny, ny)), np.empty(ny), np.empty(ny, dtype=np.bool_), np.empty(ny, dtype=np.int64),
    )  # fmt: skip


@routine
def add_measured(y, y_hat, H, U, fresh, UR, block_of, sum_e, samples, s):  # type: ignore[no-untyped-def]
    """Add E[e e' | y] of one sample: rows U H' and the residual, completed where outputs are missing.

    Args:
        y, y_hat: (ny,) outputs, NaN where missing, and their expectation; H: (ny, n); U: (n, n) smoothed factor.
        fresh: whether H or U are others than in the last call, which the spread then is not that of.
        UR, block_of, sum_e, samples: as in ``add_sample``.
        s: ``Scratch``.

    Returns:
        Whether the spread is that of H and U now: it is not where outputs are missing.
    """
    ny, n = H.shape
    count = 0
    for i in range(ny):
        s.seen[i] = not math.isnan(y[i])
        count += 1 if s.seen[i] else 0
    if count == 0:
        return False
    if fresh or count < ny:
        transpose(H, s.Ht)
        upper_times(U, s.Ht, s.E, 0)
    if fresh and count == ny:
        products(s.E, n, s.P)
    for i in range(ny):
        if not s.seen[i]:
            for r in range(n):
                s.E[r, i] = 0.0
        s.E[n, i] = y[i] - y_hat[i] if s.seen[i] else 0.0
    if count == ny:
        for i in range(ny):
            for j in range(ny):
                sum_e[i, j] += s.E[n, i] * s.E[n, j] + s.P[i, j]
            samples[i] += 1.0
    else:
        add_sample(s.E, n + 1, s.seen, UR, block_of, s.block, sum_e, samples, s.W, s.w)
    return count == ny

"""The M-step of a covariance of which single entries are free: the others held, or several variances one unknown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from noiseid_cli.models.recording import Array

Entries = Sequence[tuple[int, int]]
# A share of the step below which the search gives up: nothing higher can be told from where it is.
SHORTEST = 1e-12


def maximise_entries(S: Array, Q: Array, free: Entries, ties: Array) -> Array:
    """The covariance that maximises -1/2 [log det Q + tr(Q^-1 S)] over its free entries.

    Newton's method with step-halving; it never leaves the positive definite matrices. Where the observed information
    is not positive definite the expected one takes its place (Fisher scoring).

    Args:
        S: (p, p) second moment.
        Q: (p, p) where the search starts; entries that are not free keep their values.
        free: entries (i, j), i >= j.
        ties: (unknowns, entries) 1 where an entry belongs to an unknown, else 0.
    """
    value = _objective(Q, S)
    for _ in range(200):
        inverse = np.linalg.inv(Q).astype(np.float64)
        moment = inverse @ S @ inverse
        slope = moment - inverse
        g = np.array([slope[i, j] * (0.5 if i == j else 1.0) for i, j in free])
        g = ties @ g
        expected = ties @ _information(inverse, inverse, free) @ ties.T
        observed = 2.0 * ties @ _information(inverse, moment, free) @ ties.T - expected
        definite = bool(np.linalg.eigvalsh(observed)[0] > 0.0)
        step = np.linalg.solve(observed if definite else expected, g)
        decrement = float(g @ step)
        step = step @ ties
        if decrement < 1e-26:
            break
        # Below this the gain drowns in the objective's rounding: the full step is right there.
        drowned = 1e-10 * max(1.0, abs(value))
        length = 1.0
        trial = _moved(Q, free, step)
        while decrement > drowned and _objective(trial, S) <= value:
            length /= 2.0
            if length < SHORTEST:
                return Q
            trial = _moved(Q, free, length * step)
        Q, value = trial, _objective(trial, S)
    return Q


def _moved(Q: Array, free: Entries, step: Array) -> Array:
    """Q with ``step`` added to its free entries."""
    out = Q.copy()
    for (i, j), d in zip(free, step, strict=True):
        out[i, j] = out[j, i] = Q[i, j] + d
    return out


def _objective(Q: Array, S: Array) -> float:
    """-[log det Q + tr(Q^-1 S)], minus infinity outside the positive definite matrices."""
    try:
        L = np.linalg.cholesky(Q)
    except np.linalg.LinAlgError:
        return -np.inf
    return float(-2.0 * np.sum(np.log(np.diag(L))) - np.trace(np.linalg.solve(Q, S)))


def _information(A: Array, B: Array, free: Entries) -> Array:
    """1/2 tr(A E_a B E_b) for all pairs of free entries, E_ij the symmetric unit matrix of an entry; A, B symmetric."""
    i, j = np.array(free).T
    c = np.where(i == j, 0.5, 1.0)

    ii, ij, ji, jj = (np.ix_(a, b) for a, b in ((i, i), (i, j), (j, i), (j, j)))
    terms = A[ij] * B[ji] + A[jj] * B[ii] + A[ii] * B[jj] + A[ji] * B[ij]
    half: Array = 0.5 * np.outer(c, c) * terms
    return half

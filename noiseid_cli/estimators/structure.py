"""Which entries of a covariance are unknown, its M-step, and coordinates in which steps may be taken freely.

A structure is a pattern of free entries: blocks on the diagonal (one block: full; blocks of one: diagonal), a scalar
times a given matrix, or any of the former with entries held at given values.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.models.recording import Array


@dataclass(frozen=True)
class CovarianceStructure:
    """The unknown part of one covariance.

    Attributes:
        start: (p, p) start value; held entries keep the value they have here.
        blocks: index groups; entries across groups are zero.
        scale: the unknown is one factor on ``start``; blocks and held are then not read.
        held: entries (i, j), i >= j, that keep their start value.
        what: name for messages.
    """

    start: Array
    blocks: tuple[tuple[int, ...], ...]
    scale: bool = False
    held: frozenset[tuple[int, int]] = frozenset()
    what: str = "covariance"

    @classmethod
    def full(cls, start: Array, what: str = "covariance") -> CovarianceStructure:
        """Every entry is free."""
        return cls(start, (tuple(range(len(start))),), what=what)

    @classmethod
    def diagonal(cls, start: Array, what: str = "covariance") -> CovarianceStructure:
        """Every variance is free, every covariance is zero."""
        return cls(start, tuple((i,) for i in range(len(start))), what=what)

    @classmethod
    def scaled(cls, start: Array, what: str = "covariance") -> CovarianceStructure:
        """One free factor on the start value."""
        return cls(start, (tuple(range(len(start))),), scale=True, what=what)

    @cached_property
    def block_of(self) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
        """(p,) number of the block that each index belongs to."""
        out = np.zeros(len(self.start), dtype=np.int64)
        for number, block in enumerate(self.blocks):
            out[list(block)] = number
        return out

    @cached_property
    def free(self) -> tuple[tuple[int, int], ...]:
        """Free entries (i, j), i >= j, in the order of ``coordinates``."""
        pairs = [(i, j) for block in self.blocks for i in sorted(block) for j in sorted(block) if j <= i]
        return tuple(pair for pair in pairs if pair not in self.held)

    @property
    def is_diagonal(self) -> bool:
        """Every variance is free and every covariance zero."""
        return not self.scale and not self.held and all(len(block) == 1 for block in self.blocks)

    def check(self) -> None:
        """Refuse a start that EM could never leave.

        Raises:
            EstimationError: the start is not positive definite, or it breaks its own structure.
        """
        if not np.all(np.isfinite(self.start)):
            raise EstimationError(f"the start of {self.what} has entries that are not finite numbers")
        scales = np.sqrt(np.diag(self.start))
        zero = np.flatnonzero(~(scales > 0.0))
        if zero.size:
            raise EstimationError(
                f"the start of {self.what} has zero variance at position {zero[0] + 1}: zero is a fixed point of EM, "
                "so that the estimate would stay there; start from a positive value"
            )
        smallest = np.linalg.eigvalsh(self.start / np.outer(scales, scales))[0]
        if smallest <= len(scales) * np.finfo(float).eps:
            raise EstimationError(
                f"the start of {self.what} is singular (smallest eigenvalue of its correlations {smallest:.2g}): EM "
                "never leaves a singular start; give a positive definite one"
            )
        if not self.scale:
            across = self.block_of[:, None] != self.block_of[None, :]
            if np.any(self.start[across] != 0.0):
                raise EstimationError(f"the start of {self.what} has entries across its blocks, which must be zero")
        if not self.scale and not self.free:
            raise EstimationError(f"every entry of {self.what} is held: declare it as known instead")

    def maximise(self, S: Array, current: Array) -> Array:
        """The M-step: the covariance of this structure that maximises -1/2 [log det Q + tr(Q^-1 S)].

        Args:
            S: (p, p) second moment of the noise given the data.
            current: (p, p) the present value, from which the search starts where no closed form exists.
        """
        if self.scale:
            return self.start * float(np.trace(np.linalg.solve(self.start, S)) / len(S))
        Q = np.where(self.block_of[:, None] == self.block_of[None, :], S, 0.0)
        return self._score(S, current) if self.held else Q

    def _score(self, S: Array, Q: Array) -> Array:
        """Newton's method over the free entries, with step-halving; never leaves the positive definite matrices.

        Where the observed information is not positive definite the expected one takes its place (Fisher scoring).
        """
        value = _objective(Q, S)
        for _ in range(200):
            inverse = np.linalg.inv(Q).astype(np.float64)
            moment = inverse @ S @ inverse
            slope = moment - inverse
            g = np.array([slope[i, j] * (0.5 if i == j else 1.0) for i, j in self.free])
            expected = _information(inverse, inverse, self.free)
            observed = 2.0 * _information(inverse, moment, self.free) - expected
            definite = bool(np.linalg.eigvalsh(observed)[0] > 0.0)
            step = np.linalg.solve(observed if definite else expected, g)
            decrement = float(g @ step)
            if decrement < 1e-26:
                break
            # Below about 1e-10 the gain drowns in the objective's rounding: the full step is right there.
            length = 1.0
            trial = self._moved(Q, step)
            while decrement > 1e-10 and _objective(trial, S) <= value:
                length /= 2.0
                trial = self._moved(Q, length * step)
            Q, value = trial, _objective(trial, S)
        return Q

    def _moved(self, Q: Array, step: Array) -> Array:
        """Q with ``step`` added to its free entries."""
        out = Q.copy()
        for (i, j), d in zip(self.free, step, strict=True):
            out[i, j] = out[j, i] = Q[i, j] + d
        return out

    def coordinates(self, Q: Array) -> Array:
        """Free coordinates of Q, in which any real vector is a covariance (but for held entries).

        Blocks: log L_ii and L_ij / L_ii of the Cholesky factor; scale: the log of the factor; held entries: log
        variances and covariances over the start's standard deviations. A change of units shifts them only.
        """
        if self.scale:
            return np.array([0.5 * np.log(np.trace(np.linalg.solve(self.start, Q)) / len(Q))])
        if self.held:
            s = np.sqrt(np.diag(self.start))
            return np.array([0.5 * np.log(Q[i, i]) if i == j else Q[i, j] / (s[i] * s[j]) for i, j in self.free])
        parts = []
        for block in self.blocks:
            L = np.linalg.cholesky(Q[np.ix_(block, block)])
            d = np.diag(L)
            parts += [np.log(d), (L / d[:, None])[np.tril_indices(len(d), -1)]]
        return np.concatenate(parts)

    def covariance(self, z: Array) -> Array:
        """The covariance with these coordinates; may be indefinite only where entries are held."""
        if self.scale:
            return self.start * float(np.exp(2.0 * z[0]))
        Q = np.zeros_like(self.start)
        if self.held:
            Q = np.where(self.block_of[:, None] == self.block_of[None, :], self.start, 0.0)
            s = np.sqrt(np.diag(self.start))
            for (i, j), value in zip(self.free, z, strict=True):
                Q[i, j] = Q[j, i] = np.exp(2.0 * value) if i == j else value * s[i] * s[j]
            return Q
        at = 0
        for block in self.blocks:
            p = len(block)
            L = np.eye(p)
            d = np.exp(z[at : at + p])
            L[np.tril_indices(p, -1)] = z[at + p : at + p + p * (p - 1) // 2]
            L *= d[:, None]
            Q[np.ix_(block, block)] = L @ L.T
            at += p + p * (p - 1) // 2
        return Q

    def jacobian(self, z: Array) -> Array:
        """(coordinates, p, p) exact derivatives of ``covariance`` in each coordinate."""
        Q = self.covariance(z)
        out = np.zeros((len(z), *Q.shape))
        if self.scale:
            out[0] = 2.0 * Q
            return out
        if self.held:
            s = np.sqrt(np.diag(self.start))
            for a, (i, j) in enumerate(self.free):
                out[a, i, j] = out[a, j, i] = 2.0 * Q[i, i] if i == j else s[i] * s[j]
            return out
        at = 0
        for block in self.blocks:
            L = np.linalg.cholesky(Q[np.ix_(block, block)])
            p = len(block)
            places = [(i, i) for i in range(p)] + [(i, j) for i in range(p) for j in range(i)]
            for i, j in places:
                # log L_ii scales row i of L; L_ij / L_ii moves the one entry.
                d = np.zeros_like(L)
                d[i] = L[i] if i == j else np.eye(p)[j] * L[i, i]
                out[at][np.ix_(block, block)] = d @ L.T + L @ d.T
                at += 1
        return out

    @cached_property
    def coordinate_places(self) -> tuple[tuple[int, int], ...]:
        """Entry (i, j), i >= j, that each coordinate belongs to; (-1, -1) for a factor on the whole."""
        if self.scale:
            return ((-1, -1),)
        if self.held:
            return self.free
        places: list[tuple[int, int]] = []
        for block in self.blocks:
            places += [(i, i) for i in block]
            places += [(block[a], block[b]) for a in range(len(block)) for b in range(a)]
        return tuple(places)


def _objective(Q: Array, S: Array) -> float:
    """-[log det Q + tr(Q^-1 S)], minus infinity outside the positive definite matrices."""
    try:
        L = np.linalg.cholesky(Q)
    except np.linalg.LinAlgError:
        return -np.inf
    return float(-2.0 * np.sum(np.log(np.diag(L))) - np.trace(np.linalg.solve(Q, S)))


def _information(A: Array, B: Array, free: tuple[tuple[int, int], ...]) -> Array:
    """1/2 tr(A E_a B E_b) for all pairs of free entries, E_ij the symmetric unit matrix of an entry; A, B symmetric."""
    i, j = np.array(free).T
    c = np.where(i == j, 0.5, 1.0)

    ii, ij, ji, jj = (np.ix_(a, b) for a, b in ((i, i), (i, j), (j, i), (j, j)))
    terms = A[ij] * B[ji] + A[jj] * B[ii] + A[ii] * B[jj] + A[ji] * B[ij]
    half: Array = 0.5 * np.outer(c, c) * terms
    return half

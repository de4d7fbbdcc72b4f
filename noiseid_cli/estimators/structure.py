"""Which entries of a covariance are unknown, its M-step, and coordinates in which steps may be taken freely.

A structure is a pattern of free entries: blocks on the diagonal (one block: full; blocks of one: diagonal), a scalar
times a given matrix, or one of the former with entries held at given values or variances tied to be equal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.entry_scoring import maximise_entries
from noiseid_cli.models.recording import Array


@dataclass(frozen=True)
class CovarianceStructure:
    """The unknown part of one covariance.

    Attributes:
        start: (p, p) start value; held entries keep the value they have here.
        blocks: index groups; entries across groups are zero.
        scale: the unknown is one factor on ``start``; blocks and held are then not read.
        held: entries (i, j), i >= j, that keep their start value.
        tied: groups of positions whose variances are equal; not with ``scale``.
        what: name for messages.
    """

    start: Array
    blocks: tuple[tuple[int, ...], ...]
    scale: bool = False
    held: frozenset[tuple[int, int]] = frozenset()
    tied: tuple[tuple[int, ...], ...] = ()
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

    @cached_property
    def groups(self) -> tuple[tuple[tuple[int, int], ...], ...]:
        """Free entries, those that are one unknown together: tied variances."""
        first = {i: group[0] for group in self.tied for i in group}
        found: dict[tuple[int, int], list[tuple[int, int]]] = {}
        for i, j in self.free:
            found.setdefault((first.get(i, i), first.get(i, i)) if i == j else (i, j), []).append((i, j))
        return tuple(tuple(entries) for entries in found.values())

    @cached_property
    def is_linear(self) -> bool:
        """Some entries are held or tied, so that the free entries themselves are the coordinates, not a factor's."""
        return bool(self.held or self.tied) and not self.scale

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
        for group in self.tied:
            if any((i, i) in self.held for i in group):
                raise EstimationError(f"a variance of {self.what} is held and tied: it can be one only")
            if np.ptp(np.diag(self.start)[list(group)]) > 0.0:
                raise EstimationError(f"tied variances of {self.what} must start at one value")

    def maximise(self, S: Array, current: Array) -> Array:
        """The M-step: the covariance of this structure that maximises -1/2 [log det Q + tr(Q^-1 S)].

        Args:
            S: (p, p) second moment of the noise given the data.
            current: (p, p) the present value, from which the search starts where no closed form exists.
        """
        if self.scale:
            return self.start * float(np.trace(np.linalg.solve(self.start, S)) / len(S))
        Q = np.where(self.block_of[:, None] == self.block_of[None, :], S, 0.0)
        return maximise_entries(S, current, self.free, self._ties) if self.is_linear else Q

    @cached_property
    def _ties(self) -> Array:
        """(groups, free) which free entries belong to which unknown."""
        return np.array([[float(entry in group) for entry in self.free] for group in self.groups])

    def coordinates(self, Q: Array) -> Array:
        """Free coordinates of Q, in which any real vector is a covariance (but for held entries).

        Blocks: log L_ii and L_ij / L_ii of the Cholesky factor; scale: half the log of the factor; held or tied
        entries: log standard deviations, and covariances over the start's standard deviations. A change of units
        shifts them only.
        """
        if self.scale:
            return np.array([0.5 * np.log(np.trace(np.linalg.solve(self.start, Q)) / len(Q))])
        if self.is_linear:
            s = np.sqrt(np.diag(self.start))
            entries = [group[0] for group in self.groups]
            return np.array([0.5 * np.log(Q[i, i]) if i == j else Q[i, j] / (s[i] * s[j]) for i, j in entries])
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
        if self.is_linear:
            Q = np.where(self.block_of[:, None] == self.block_of[None, :], self.start, 0.0)
            s = np.sqrt(np.diag(self.start))
            for group, value in zip(self.groups, z, strict=True):
                for i, j in group:
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
        if self.is_linear:
            s = np.sqrt(np.diag(self.start))
            for a, group in enumerate(self.groups):
                for i, j in group:
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
        """Entry (i, j), i >= j, of each coordinate; (-1, -1) for a factor on the whole; of tied variances the first."""
        if self.scale:
            return ((-1, -1),)
        if self.is_linear:
            return tuple(group[0] for group in self.groups)
        places: list[tuple[int, int]] = []
        for block in self.blocks:
            places += [(i, i) for i in block]
            places += [(block[a], block[b]) for a in range(len(block)) for b in range(a)]
        return tuple(places)

    def names(self, of: Sequence[str]) -> tuple[str, ...]:
        """Names of the coordinates, given those of the rows."""
        if self.scale:
            return (f"half the log of the factor on {self.what}",)
        own = {block[0] for block in self.blocks} if not self.is_linear else set(range(len(of)))
        # Within a block, L_ii is a standard deviation given the rows before it.
        return tuple(
            f"log std({of[i]})"
            if i == j and i in own
            else f"log L({of[i]})"
            if i == j
            else f"L({of[i]}, {of[j]}) scaled"
            for i, j in self.coordinate_places
        )

"""What cross-sectional estimation works on: independent tests of one linear system, and the parameters theta.

    x_0 = a + T_i b, a ~ N(0, S_a(alpha)), b ~ N(mu, Sigma) drawn anew in each test (porter1983, eq. 5 to 8)

mu, Sigma (together beta) and the dynamical parameters alpha are unknown.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from noiseid_cli.errors import DataError, EstimationError, ModelError
from noiseid_cli.models.parametric import ParametricMatrices
from noiseid_cli.models.recording import Array, Recording

Family = Callable[[Array, Recording], ParametricMatrices]
"""The matrices of one test at given alpha (na,)."""


@dataclass(frozen=True)
class CommonBias:
    """A bias c that tests share, such as that of an instrument: c_1 ~ N(0, first), c_{i+1} = c_i + N(0, walk).

    A constant bias (walk zero) is confounded with the mean of whatever it looks like: more tests do not help there.

    Attributes:
        first: (nc, nc) covariance in the first test; walk: (nc, nc) covariance of the change from test to test.
    """

    first: Array
    walk: Array


@dataclass(frozen=True)
class CrossSection:
    """Tests of one system, independent unless they share a bias.

    Attributes:
        family: gives the matrices of each test.
        recordings: the tests; lengths, intervals, inputs and missing outputs may differ. x_0 belongs to the first
            sample: where the first measurement comes one interval later, the first y is NaN.
        maps: T_i of each test, (nx, nb); with a common bias (nx, nb + nc), the last columns being those of c.
        common: the bias that tests share, if any; then their order counts.
    """

    family: Family
    recordings: tuple[Recording, ...]
    maps: tuple[Array, ...]
    common: CommonBias | None = None

    @classmethod
    def common_map(cls, family: Family, recordings: tuple[Recording, ...], T: Array) -> CrossSection:
        """Tests that share one T."""
        return cls(family, recordings, (T,) * len(recordings))

    def __post_init__(self) -> None:
        """Check what all methods rely on.

        Raises:
            DataError: no tests, or an input that is not a finite number.
            ModelError: the maps do not fit the tests or each other.
        """
        if not self.recordings:
            raise DataError("cross-sectional estimation needs at least one test")
        if len(self.maps) != len(self.recordings) or len({T.shape[1] for T in self.maps}) != 1:
            raise ModelError("there must be one map T per test, all with the same number of columns")
        for recording in self.recordings:
            if not np.all(np.isfinite(recording.u)):
                raise DataError(f"test {recording.name!r}: an input is missing or not finite; inputs must be complete")

    def __len__(self) -> int:
        """Number of tests."""
        return len(self.recordings)

    @property
    def nb(self) -> int:
        """Number of components of b."""
        return int(self.maps[0].shape[1]) - (0 if self.common is None else len(self.common.first))

    def select(self, index: slice) -> CrossSection:
        """Some of the tests."""
        return replace(self, recordings=self.recordings[index], maps=self.maps[index])

    def matrices(self, i: int, alpha: Array) -> ParametricMatrices:
        """Matrices of test i, with the time axes checked against its length.

        Raises:
            ModelError: they do not fit the test.
        """
        m, recording = self.family(alpha, self.recordings[i]), self.recordings[i]
        N = recording.samples
        if m.A.shape[-1] != len(self.maps[i]) or m.C.shape[1:2] != recording.y.shape[1:]:
            raise ModelError(f"test {recording.name!r}: matrices, map T and outputs have different sizes")
        if m.B.shape[-1] != recording.u.shape[1]:
            raise ModelError(
                f"test {recording.name!r}: {recording.u.shape[1]} inputs, but B has {m.B.shape[-1]} columns"
            )
        for name, length in (("A", N - 1), ("B", N - 1), ("Q", N - 1), ("C", N), ("D", N), ("R", N)):
            if len(getattr(m, name)) not in (1, length):
                raise ModelError(
                    f"test {recording.name!r}: matrix {name} is given at {len(getattr(m, name))} times, "
                    f"expected 1 or {length}"
                )
        return m


@dataclass(frozen=True)
class Theta:
    """Values of the unknowns: mean mu (nb,) and covariance Sigma (nb, nb) of b, parameters alpha (na,)."""

    mu: Array
    Sigma: Array
    alpha: Array


@dataclass(frozen=True)
class Coordinates:
    """theta as a vector: mu, the free entries of Sigma, alpha or its logarithms.

    Sigma stays in natural units: zero is an admissible estimate, and in log-variances the information vanishes there.

    Attributes:
        nb, na: sizes of b and alpha.
        structure: ``full`` or ``diagonal`` Sigma.
        log_alpha: all alpha are positive, and log alpha is the coordinate.
    """

    nb: int
    na: int
    structure: Literal["full", "diagonal"] = "diagonal"
    log_alpha: bool = True

    @cached_property
    def rows(self) -> list[int]:
        """First index m of each free entry (m, n), m <= n."""
        return [m for m in range(self.nb) for n in range(m, self.nb) if self.structure == "full" or m == n]

    @cached_property
    def columns(self) -> list[int]:
        """Second index n of each free entry."""
        return [n for m in range(self.nb) for n in range(m, self.nb) if self.structure == "full" or m == n]

    @property
    def n_beta(self) -> int:
        """Number of entries of mu and Sigma."""
        return self.nb + len(self.rows)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.n_beta + self.na

    def pack(self, theta: Theta) -> Array:
        """The vector (size,)."""
        alpha = np.log(theta.alpha) if self.log_alpha else theta.alpha
        return np.concatenate((theta.mu, theta.Sigma[self.rows, self.columns], alpha))

    def unpack(self, vector: Array) -> Theta:
        """Back from the vector."""
        Sigma = np.zeros((self.nb, self.nb))
        Sigma[self.rows, self.columns] = Sigma[self.columns, self.rows] = vector[self.nb : self.n_beta]
        alpha = vector[self.n_beta :]
        return Theta(vector[: self.nb].copy(), Sigma, np.exp(alpha) if self.log_alpha else alpha.copy())

    def slopes(self, theta: Theta) -> Array:
        """(size,) derivative of (mu, Sigma, alpha) in the coordinates."""
        return np.concatenate((np.ones(self.n_beta), theta.alpha if self.log_alpha else np.ones(self.na)))

    def check(self, theta: Theta) -> None:
        """Check a start.

        Raises:
            EstimationError: sizes do not fit, alpha is not positive where it must be, or Sigma is not of its structure.
        """
        if theta.mu.shape != (self.nb,) or theta.Sigma.shape != (self.nb, self.nb) or theta.alpha.shape != (self.na,):
            raise EstimationError(
                f"start: mu, Sigma, alpha have shapes {theta.mu.shape}, {theta.Sigma.shape}, {theta.alpha.shape}, "
                f"expected {(self.nb,)}, {(self.nb, self.nb)}, {(self.na,)}"
            )
        if self.log_alpha and not np.all(theta.alpha > 0.0):
            raise EstimationError("start: every alpha must be positive, its logarithm is estimated")
        if not np.array_equal(self.unpack(self.pack(theta)).Sigma, theta.Sigma):
            raise EstimationError(f"start: Sigma must be symmetric and {self.structure}")
        if np.linalg.eigvalsh(theta.Sigma)[0] < -1e-12 * np.trace(theta.Sigma):
            raise EstimationError("start: Sigma must be positive semidefinite")

"""An ensemble of tests as a user poses it: which unknowns a linear or nonlinear model and its first state have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.cross_sectional.correlated import with_output_bias
from noiseid_cli.estimators.cross_sectional.extended import linearised
from noiseid_cli.estimators.cross_sectional.problem import CommonBias, Coordinates, CrossSection, Theta
from noiseid_cli.estimators.estimate import Columns
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.linear_family import LinearFamily
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording

BOUNDARY = 1e-9
"""An eigenvalue of the correlations of b that is less negative counts as zero."""


@dataclass(frozen=True)
class FirstState:
    """x_0 = a + T_i b, b ~ N(mu, Sigma) drawn anew in each test; a is what the model says of the first state.

    Attributes:
        columns: (name, unit, description) of each component of b.
        maps: T_i of each test, (nx, nb).
        common: a bias of the outputs that tests share; E (ny, nc) is the outputs that it acts on.
        E: see ``common``.
    """

    columns: Columns
    maps: tuple[Array, ...]
    common: CommonBias | None = None
    E: Array | None = None


@dataclass(frozen=True)
class Ensemble:
    """Tests of one model, and what is unknown about it and about its first state.

    Attributes:
        family: the model's matrices, whose alpha are unknown; also the source of Q and R.
        compiled: the compiled equations of a nonlinear model, which is linearised anew about every path; None for a
            linear one.
        recordings: the tests.
        first: law of the first state.
        start: where the estimation begins.
        coordinates: which entries of Sigma are free, and whether all alpha are positive.
        alpha_names: of each alpha.
    """

    family: LinearFamily
    compiled: CompiledModel | None
    recordings: tuple[Recording, ...]
    first: FirstState
    start: Theta
    coordinates: Coordinates
    alpha_names: Columns

    def __len__(self) -> int:
        """Number of tests."""
        return len(self.recordings)

    @cached_property
    def names(self) -> Columns:
        """(name, unit, description) of every entry of theta."""
        b, c = self.first.columns, self.coordinates
        means = [(f"initial mean {name}", unit, f"mean of the first {text or name}") for name, unit, text in b]
        spreads = []
        for m, n in zip(c.rows, c.columns, strict=True):
            (first, unit, text), (second, other, _) = b[m], b[n]
            if m == n:
                spreads.append((f"initial variance {first}", _squared(unit), f"variance of the first {text or first}"))
            else:
                name = f"initial covariance {first}, {second}"
                spreads.append((name, f"({unit}) ({other})", f"covariance of the first {first} and {second}"))
        return (*means, *spreads, *self.alpha_names)

    @property
    def log_scale(self) -> tuple[bool, ...]:
        """Which unknowns cannot be negative."""
        c = self.coordinates
        variances = [m == n for m, n in zip(c.rows, c.columns, strict=True)]
        return (*(False,) * c.nb, *variances, *(c.log_alpha,) * c.na)

    def tests(self, theta: Theta, which: slice = slice(None)) -> CrossSection:
        """The tests as linear ones; those of a nonlinear model about the paths that theta smooths them to.

        Raises:
            FilterDivergedError: the extended Kalman filter of a nonlinear model fails.
        """
        recordings, maps = self.recordings[which], self.first.maps[which]
        family = self.family
        if self.compiled is not None:
            Q, R = family.noise(theta.alpha)
            parts = [
                linearised(self.compiled, family, r, NoiseValues(Q, R, (T @ theta.mu)[None], self._spread(theta, T)))
                for r, T in zip(recordings, maps, strict=True)
            ]
            recordings = tuple(part.recording for part in parts)
            matrices = {r.name: part.matrices for r, part in zip(recordings, parts, strict=True)}

            def about_paths(alpha: Array, recording: Recording):  # type: ignore[no-untyped-def]
                return matrices[recording.name](alpha)

            return CrossSection(about_paths, recordings, maps)
        if self.first.common is None:
            return CrossSection(family, recordings, maps)
        assert self.first.E is not None
        biased, wide = with_output_bias(family, maps, self.first.E)
        return CrossSection(biased, recordings, wide, self.first.common)

    def _spread(self, theta: Theta, T: Array) -> Array:
        """Covariance of the first state, the model's own part left to the matrices.

        On the boundary of the admissible set Sigma may have an eigenvalue that is negative by rounding; a filter's
        factor has none.
        """
        scale = np.sqrt(np.diag(theta.Sigma))
        scale = np.where(scale > 0.0, scale, 1.0)
        values, vectors = np.linalg.eigh(theta.Sigma / np.outer(scale, scale))
        if values[0] >= 0.0 or values[0] < -BOUNDARY:
            return np.asarray(T @ theta.Sigma @ T.T)
        half = T @ (scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))
        return np.asarray(half @ half.T)

    def noise(self, theta: Theta) -> NoiseValues:
        """Theta as noise values; the covariance of the first state is that under the first test's map."""
        Q, R = self.family.noise(theta.alpha)
        m0 = np.array([T @ theta.mu for T in self.first.maps])
        own = self.family(theta.alpha, self.recordings[0]).S_a if self.compiled is None else 0.0
        return NoiseValues(Q, R, m0, self._spread(theta, self.first.maps[0]) + own)

    def select(self, count: int) -> Ensemble:
        """The first tests alone."""
        first = FirstState(self.first.columns, self.first.maps[:count], self.first.common, self.first.E)
        return Ensemble(
            self.family, self.compiled, self.recordings[:count], first, self.start, self.coordinates, self.alpha_names
        )


def _squared(unit: str) -> str:
    """Unit of a variance."""
    return f"{unit}^2" if unit.isalpha() else f"({unit})^2"


def observed(recordings: Sequence[Recording]) -> int:
    """Number of scalar measurements: each adds -1/2 log 2 pi to a log-likelihood."""
    return sum(int(np.isfinite(r.y).sum()) for r in recordings)


def check_first(first: FirstState, recordings: Sequence[Recording], nx: int) -> None:
    """Refuse maps that do not fit.

    Raises:
        EstimationError: naming the test, the shape and what it must be.
    """
    nb = len(first.columns)
    for recording, T in zip(recordings, first.maps, strict=True):
        if T.shape != (nx, nb):
            raise EstimationError(
                f"test {recording.name!r}: the map of the first state has the shape {T.shape}, expected {(nx, nb)}: "
                f"a row for each state, a column for each of {', '.join(name for name, _, _ in first.columns)}"
            )

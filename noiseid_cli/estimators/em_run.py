"""One run of EM over its data: visits points, tries accelerated ones, keeps everything that was seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from noiseid_cli.estimators.em_statistics import Statistics, e_step
from noiseid_cli.estimators.ends import false_end
from noiseid_cli.estimators.estimate import Progress
from noiseid_cli.estimators.unknowns import Unknowns
from noiseid_cli.filters.ekf import FilterDivergedError
from noiseid_cli.filters.sigma_points import SigmaWeights
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording


@dataclass
class EmPoint:
    """A point, its log-likelihood, and the EM step from it.

    Attributes:
        noise: the point.
        loglik: log-likelihood there.
        after: where the EM step from it leads.
        change: size of that step, see ``Unknowns.change``.
        extrapolated: the point came from an acceleration, not from an EM step.
        accepted: the run could go on from it.
    """

    noise: NoiseValues
    loglik: float
    after: NoiseValues
    change: float
    extrapolated: bool = False
    accepted: bool = True


@dataclass
class EmRun:
    """Counts passes, keeps every visited point and each safeguard that acted.

    Attributes:
        model, recordings, unknowns: the problem.
        linearisation: of the E-step, see ``e_step``.
        weights: of a sigma-point smoother; None for the extended one.
        fall_tolerance: fall of the log-likelihood up to which an accelerated point is accepted.
        progress: called after each pass.
        points: all that were visited, in order; one pass each.
        falls: by how much plain EM steps lowered the log-likelihood.
        divergences: why the filter failed at accelerated points.
        indefinite: number of accelerated points that were no covariances.
        statistics: what the last pass gathered.
        singular: number of singular predictions.
    """

    model: CompiledModel
    recordings: Sequence[Recording]
    unknowns: Unknowns
    linearisation: int
    weights: SigmaWeights | None
    fall_tolerance: float
    progress: Progress | None = None
    points: list[EmPoint] = field(default_factory=list)
    falls: list[float] = field(default_factory=list)
    divergences: list[str] = field(default_factory=list)
    indefinite: int = 0
    singular: int = 0
    statistics: Statistics | None = None

    @property
    def passes(self) -> int:
        """Passes over the data so far."""
        return len(self.points)

    @property
    def best(self) -> EmPoint:
        """The visited point of greatest log-likelihood."""
        return max(self.points, key=lambda p: p.loglik)

    def visit(self, noise: NoiseValues, extrapolated: bool = False) -> EmPoint:
        """One pass: log-likelihood at ``noise`` and the EM step from there.

        Raises:
            FilterDivergedError: the filter fails there.
        """
        blocks = None if self.unknowns.R is None else self.unknowns.R.block_of
        statistics = e_step(self.model, self.recordings, noise, self.linearisation, blocks, self.weights)
        after = self.unknowns.maximise(statistics, noise)
        point = EmPoint(noise, statistics.loglik, after, self.unknowns.change(noise, after), extrapolated)
        self.points.append(point)
        self.statistics = statistics
        self.singular += statistics.singular
        if self.progress is not None:
            self.progress(self.passes, point.loglik)
        return point

    def attempt(self, candidate: NoiseValues, least: float) -> EmPoint | None:
        """The point at an accelerated ``candidate``; accepted if its log-likelihood does not fall below ``least``.

        None if the candidate is no covariance or the filter fails there.
        """
        if not _usable(candidate):
            self.indefinite += 1
            return None
        try:
            point = self.visit(candidate, extrapolated=True)
        except FilterDivergedError as error:
            self.divergences.append(str(error))
            return None
        point.accepted = point.loglik >= least - self.fall_tolerance
        return point

    def too_low(self, now: EmPoint) -> str:
        """Name of a covariance that is too small by powers of ten; empty if none is."""
        return false_end(self.model, self.recordings, self.unknowns, now.noise, now.loglik, self.weights)


def _usable(noise: NoiseValues) -> bool:
    """All covariances are finite and positive definite (only held entries can make one indefinite)."""
    for P in (noise.Q, noise.R, noise.P0):
        if not np.all(np.isfinite(P)) or np.any(np.diag(P) < 0.0):
            return False
        scale = np.sqrt(np.diag(P))
        if np.any(scale > 0.0):
            kept = scale > 0.0
            correlation = P[np.ix_(kept, kept)] / np.outer(scale[kept], scale[kept])
            if np.linalg.eigvalsh(correlation)[0] < -1e-12:
                return False
    return True

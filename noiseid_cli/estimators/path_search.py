"""The objective of Alg. 2: the filter's path error as a function of log lambda, with a record of every evaluation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from noiseid_cli.estimators.estimate import Progress
from noiseid_cli.filters.ekf import FilterDivergedError, extended_kalman_filter
from noiseid_cli.filters.path_error import performance_error
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording

# Step of the differences in log lambda: what rounding does to the filter is 1e-4 of what this step does.
DIFFERENCE = 1e-4


class SpentError(Exception):
    """The passes are used up."""


class LostError(Exception):
    """The filter fails on both sides of a point."""


@dataclass
class PathSearch:
    """Counts runs of the filter, keeps the path of a search and its best point; x is log lambda throughout.

    Attributes:
        model, recordings: the problem, with a performance output and its truth.
        start: the noise values at x = 0.
        max_passes: number of runs of the filter that are allowed.
        limit: the search keeps to -limit <= x_j <= limit.
        progress: called after each run that did not fail.
        path: x of each run; logliks, objectives (path errors; infinite where the filter failed): what was found there.
        improved: whether a run was the best so far; steps: largest step of a log standard deviation from the best.
        divergences: what made the filter fail, per failed run.
        best: index of the run of smallest path error.
    """

    model: CompiledModel
    recordings: Sequence[Recording]
    start: NoiseValues
    max_passes: int
    limit: float
    progress: Progress | None
    path: list[Array] = field(default_factory=list)
    logliks: list[float] = field(default_factory=list)
    objectives: list[float] = field(default_factory=list)
    improved: list[bool] = field(default_factory=list)
    steps: list[float] = field(default_factory=list)
    divergences: list[str] = field(default_factory=list)
    best: int = 0

    @property
    def unit(self) -> float:
        """What the optimisers measure the objective in: the path error at the start (1 where that is zero)."""
        return self.objectives[0] or 1.0

    def noise(self, x: Array) -> NoiseValues:
        """The noise values at x."""
        s = self.start
        return NoiseValues(np.diag(np.diag(s.Q) * np.exp(x)), s.R, s.m0, s.P0)

    def errors(self, x: Array) -> Array | None:
        """All performance errors at x in one vector, by one run of the filter; None where it fails.

        Raises:
            SpentError: no run is left.
            FilterDivergedError: the filter fails in the first run.
        """
        if len(self.path) >= self.max_passes:
            raise SpentError
        noise, parts, loglik = self.noise(x), [], 0.0
        try:
            for i, recording in enumerate(self.recordings):
                filtered = extended_kalman_filter(self.model, recording, noise, i)
                error = performance_error(self.model, recording, filtered.m_filt)
                parts.append(error[~np.isnan(error).any(axis=1)].ravel())
                loglik += filtered.loglik
        except FilterDivergedError as failure:
            if not self.path:
                raise
            self.divergences.append(str(failure))
            self._keep(x, np.nan, np.inf)
            return None
        r = np.concatenate(parts)
        self._keep(x, loglik, float(np.linalg.norm(r)))
        return r

    def jacobian(self, x: Array, r: Array) -> Array:
        """(errors, nv) slope of the errors at x by differences; r are the errors there.

        Differences are forward; at the edge of the box, and where the filter fails forward, they are backward.

        Raises:
            LostError: there is no usable point on either side.
            SpentError: no run is left.
        """
        J, step = np.empty((len(r), len(x))), min(DIFFERENCE, self.limit)
        for j in range(len(x)):
            for h in (step, -step):
                moved = x.copy()
                moved[j] += h
                there = self.errors(moved) if abs(moved[j]) <= self.limit else None
                if there is not None:
                    J[:, j] = (there - r) / h
                    break
            else:
                raise LostError
        return J

    def _keep(self, x: Array, loglik: float, objective: float) -> None:
        """Record one run."""
        first = not self.path
        improved = first or objective < self.objectives[self.best]
        self.steps.append(0.0 if first else 0.5 * float(np.max(np.abs(x - self.path[self.best]))))
        self.path.append(np.array(x))
        self.logliks.append(loglik)
        self.objectives.append(objective)
        self.improved.append(improved)
        if improved:
            self.best = len(self.path) - 1
        if self.progress is not None and np.isfinite(objective):
            self.progress(len(self.path), loglik)

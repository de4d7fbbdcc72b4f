"""The log-likelihood of the extended Kalman filter over free coordinates, with its gradient."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.coordinates import Coordinates
from noiseid_cli.estimators.estimate import Progress
from noiseid_cli.filters.ekf import FilterDivergedError, extended_kalman_filter
from noiseid_cli.filters.ekf_adjoint import has_exact_gradient, loglik_gradient
from noiseid_cli.models.recording import Array, Recording

# Step of a central difference in a coordinate: the cube root of the rounding of a sum of some thousand terms.
STEP = 1e-4


@dataclass(frozen=True)
class Point:
    """A point with the log-likelihood there and its gradient (d,)."""

    z: Array
    loglik: float
    gradient: Array


class Likelihood:
    """Evaluates points and counts the runs of the filter over the data.

    Attributes:
        coordinates: what the coordinates mean.
        exact: whether gradients are exact, or central differences.
        passes: runs of the filter over all tests so far, with or without the reverse run of the exact gradient.
        visited: each point of which the gradient was asked, in order.
        failures: what stopped the filter at points that were tried, in sentences.
    """

    def __init__(
        self,
        coordinates: Coordinates,
        recordings: Sequence[Recording],
        gradient: Literal["exact", "differences"] = "exact",
        progress: Progress | None = None,
    ) -> None:
        """Keep the problem; ``exact`` falls back on differences where the model has no adjoint."""
        self.coordinates = coordinates
        self.recordings = recordings
        self.exact = gradient == "exact" and has_exact_gradient(coordinates.model)
        self.passes = 0
        self.visited: list[Point] = []
        self.failures: list[str] = []
        self._progress = progress

    def value(self, z: Array) -> float:
        """Log-likelihood at z; -inf where a covariance is indefinite or the filter fails."""
        return self._run(z, with_gradient=False)[0]

    def point(self, z: Array) -> Point:
        """Log-likelihood and gradient at z; -inf and NaN where the filter fails.

        Central differences whose points fail on one side are NaN there.
        """
        if self.exact:
            loglik, gradient = self._run(z, with_gradient=True)
        else:
            loglik, gradient = self.value(z), np.full(z.size, np.nan)
            if np.isfinite(loglik):
                for i in range(z.size):
                    e = STEP * (np.arange(z.size) == i)
                    with np.errstate(invalid="ignore"):
                        gradient[i] = (self.value(z + e) - self.value(z - e)) / (2.0 * STEP)
        found = Point(z, loglik, gradient)
        if np.isfinite(loglik):
            self.visited.append(found)
            if self._progress is not None:
                self._progress(self.passes, loglik)
        return found

    def _run(self, z: Array, with_gradient: bool) -> tuple[float, Array]:
        nothing = (-np.inf, np.full(z.size, np.nan))
        if not np.all(np.isfinite(z)):
            return nothing
        noise, model = self.coordinates.unpack(z)
        self.passes += 1
        loglik, gradients = 0.0, []
        try:
            for i, recording in enumerate(self.recordings):
                filtered = extended_kalman_filter(model, recording, noise, i)
                loglik += filtered.loglik
                if with_gradient:
                    gradients.append(loglik_gradient(model, recording, filtered, noise.Q))
            with np.errstate(over="ignore", invalid="ignore"):  # looked at below
                slope = self.coordinates.slope(z, gradients) if with_gradient else nothing[1]
        except (FilterDivergedError, EstimationError, np.linalg.LinAlgError) as error:
            self.failures.append(str(error))
            return nothing
        if with_gradient and not np.all(np.isfinite(slope)):
            self.failures.append("the gradient of the log-likelihood is beyond the floating-point numbers")
            return nothing
        return loglik, slope

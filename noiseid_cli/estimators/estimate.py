"""What every estimator takes and gives: noise values, options common to all, and the estimate with its history."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array

__all__ = ["Columns", "Estimate", "NoiseValues", "Parameters", "Progress", "Series", "Status", "Uncertainty"]

Columns = tuple[tuple[str, str, str], ...]
"""(name, unit, description) of each column of an array."""

Status = Literal["converged", "max_passes", "stalled_fixed_point", "degenerate_data", "diverged", "numerical", "failed"]

Progress = Callable[[int, float], None]
"""Called after each pass over the data with the pass number (from 1) and the log-likelihood."""


@dataclass(frozen=True)
class Parameters:
    """Scalar unknowns that were estimated: parameters of the model, moments of the first state.

    Attributes:
        names: of each unknown.
        start, final: (p,) values.
        standard_errors: (p,) of the final values; NaN where unknown, None where the method gives none.
        log_scale: which unknowns cannot be negative, so that intervals are taken on their logarithm; none if empty.
    """

    names: Columns
    start: Array
    final: Array
    standard_errors: Array | None = None
    log_scale: tuple[bool, ...] = ()

    def interval(self, i: int, quantile: float = 1.959963984540054) -> tuple[float, float]:
        """Confidence interval of one unknown, by default of 95 %; NaN without a standard error.

        Where the unknown cannot be negative it is value * exp(-+ quantile * error / value).
        """
        if self.standard_errors is None:
            return float("nan"), float("nan")
        value, reach = float(self.final[i]), quantile * float(self.standard_errors[i])
        if not self.log_scale or not self.log_scale[i]:
            return value - reach, value + reach
        if value <= 0.0:
            # At the boundary the logarithm says nothing: the interval is one-sided.
            return 0.0, reach
        factor = math.exp(min(reach / value, 700.0))
        return value / factor, value * factor


@dataclass(frozen=True)
class Series:
    """Curves over one axis that belong to an estimate, such as a parameter over time or over tests.

    Attributes:
        name: an identifier, unique within the estimate.
        title: what it shows.
        axis: name and unit of the axis.
        at: (n,) values on the axis.
        columns: of each curve.
        values: (n, k) the curves.
    """

    name: str
    title: str
    axis: tuple[str, str]
    at: Array
    columns: Columns
    values: Array


@dataclass(frozen=True)
class Uncertainty:
    """How sure an estimate is; k figures, d free coordinates.

    Attributes:
        method: ``score`` (observed information) or ``bootstrap``.
        level: confidence level of the intervals.
        names: (metric, index, unit) of each figure, as in the tidy table, such as ``process_noise_std``, ``vm1``.
        values: (k,) the estimate.
        standard_errors: (k,) standard errors; NaN for a figure that the data do not determine. Of a figure at zero,
            (upper - value) / z with z the one-sided normal quantile.
        lower, upper: (k,) ends of the interval; one-sided at zero; the whole range where nothing is determined.
        notes: (k,) what is special about a figure; empty where nothing is.
        coordinates: (d,) labels of the free coordinates.
        information: (d, d) observed information in them; the bootstrap has none, and no coordinates.
        shares: share of the complete-data information along each eigen-direction, weakest first; see
            ``identifiability``. Fewer than d where a covariance is singular; none from the bootstrap.
        directions: the weakest directions in words.
        remarks: what a reader must know, in sentences: ridges, an end off the maximum, a linearisation that matters.
    """

    method: str
    level: float
    names: tuple[tuple[str, str, str], ...]
    values: Array
    standard_errors: Array
    lower: Array
    upper: Array
    notes: tuple[str, ...]
    coordinates: tuple[str, ...]
    information: Array
    shares: Array
    directions: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    def index(self, metric: str, index: str) -> int | None:
        """Position of a figure; None if it is not among them."""
        found = [k for k, name in enumerate(self.names) if name[:2] == (metric, index)]
        return found[0] if found else None


@dataclass(frozen=True)
class Estimate:
    """The end of one run of one estimator.

    Attributes:
        method: registered name of the method.
        status: how it ended; only ``converged`` is a success.
        reason: the same in a sentence, with the figures that decided.
        start: the values it started from.
        final: the values it ended with: em's best iterate in log-likelihood, alg2's in path error, alg3's last one.
        loglik_start, loglik: log-likelihood of both, with the -m/2 log 2 pi term.
        passes: number of passes over the data (filter and smoother; alg2: filter).
        seconds: wall-clock time of the estimation.
        trace: per pass, first axis = pass: ``loglik`` (passes,), ``Q`` (passes, nv, nv), ``R`` (passes, ny, ny),
            ``change`` (passes,) relative size of the EM step taken there, ``extrapolated`` (passes,) 1 where the
            point came from the acceleration, ``accepted`` (passes,) 0 where it was rejected; of alg2 ``objective``
            (passes,) as well, see there; with an outlier gate ``outliers`` (count, 4): test, sample and output, each
            from 1, and the innovation in standard deviations.
        safeguards: each safeguard that acted, in a sentence.
        settings: the options in force, for the report.
        parameters: scalar unknowns beside Q, R, m0 and P0; None where there are none.
        series: curves that the method has to show.
        state: arrays from which the method goes on with new recordings; empty where it cannot.
    """

    method: str
    status: Status
    reason: str
    start: NoiseValues
    final: NoiseValues
    loglik_start: float
    loglik: float
    passes: int
    seconds: float
    trace: dict[str, Array] = field(default_factory=dict)
    safeguards: tuple[str, ...] = ()
    settings: dict[str, str | float | int] = field(default_factory=dict)
    parameters: Parameters | None = None
    series: tuple[Series, ...] = ()
    state: dict[str, np.ndarray[Any, Any]] = field(default_factory=dict)


def plural(count: int, word: str) -> str:
    """Such as "1 sample", "3 samples"."""
    return f"{count} {word}" if count == 1 else f"{count} {word}s"

"""What every estimator takes and gives: noise values, options common to all, and the estimate with its history."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array

__all__ = ["Estimate", "NoiseValues", "Progress", "Status"]

Status = Literal["converged", "max_passes", "stalled_fixed_point", "degenerate_data", "diverged", "numerical", "failed"]

Progress = Callable[[int, float], None]
"""Called after each pass over the data with the pass number (from 1) and the log-likelihood."""


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
            (passes,) as well, see there.
        safeguards: each safeguard that acted, in a sentence.
        settings: the options in force, for the report.
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

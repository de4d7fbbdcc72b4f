"""Variances that the data allow to be zero: is zero excluded, and how large can they be at most?

At zero the log-likelihood has no maximum in the interior, so that no two-sided interval exists. What does exist is a
bound from the profile of the likelihood: the largest standard deviation that twice the log-likelihood ratio does not
reject, against the chi-bar-square mixture of a parameter on its boundary (Self & Liang, JASA 82, 1987, case 5).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators import em
from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.estimators.unknowns import Unknowns
from noiseid_cli.filters.ekf import FilterDivergedError
from noiseid_cli.filters.gaussian import gaussian_filter
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording

# A share of the estimate that stands for zero: what is left changes no likelihood.
ZERO = 1e-4
# Passes of EM over the other unknowns for one point of a profile; they start where they were best.
PASSES = 12
# The bound is searched by factors of this, over so many of them, then halved on the log scale to 1 %.
FACTOR, FACTORS = 4.0, 40
PRECISION = 0.01


@dataclass(frozen=True)
class Profile:
    """The log-likelihood over one standard deviation, the other unknowns at their best.

    Attributes:
        model, recordings, noise, unknowns: the problem and its estimate.
        letter: Q, R or P0; i: which of its standard deviations.
        options: of EM, of which the smoother counts.
    """

    model: CompiledModel
    recordings: Sequence[Recording]
    noise: NoiseValues
    unknowns: Unknowns
    letter: str
    i: int
    options: em.EmOptions

    @property
    def structure(self) -> CovarianceStructure:
        """Structure of the covariance that the standard deviation belongs to."""
        structure: CovarianceStructure = getattr(self.unknowns, self.letter)
        return structure

    def at(self, sd: float) -> float:
        """Log-likelihood with the standard deviation held at ``sd``; minus infinity where the filter fails."""
        value = getattr(self.noise, self.letter).copy()
        factor = sd / np.sqrt(value[self.i, self.i])
        if self.structure.scale:
            value *= factor**2
            held: CovarianceStructure | None = None
        else:
            # What is tied to it moves along.
            group = list(next((g for g in self.structure.tied if self.i in g), (self.i,)))
            value[group] *= factor
            value[:, group] *= factor
            kept = self.structure.held | {(i, i) for i in group}
            tied = tuple(g for g in self.structure.tied if self.i not in g)
            held = replace(self.structure, start=value, held=kept, tied=tied)
            held = held if held.free else None
        noise = replace(self.noise, **{self.letter: value})
        unknowns = replace(self.unknowns, **{self.letter: held})  # type: ignore[arg-type]
        try:
            if not (unknowns.Q or unknowns.R or unknowns.P0 or unknowns.m0):
                weights = self.options.weights(self.model.nx)
                runs = (gaussian_filter(self.model, r, noise, k, weights) for k, r in enumerate(self.recordings))
                return float(sum(run.loglik for run in runs))
            options = replace(self.options, max_passes=PASSES, loglik_tolerance=1e-2, stop="loglik")
            if options.smoother == "extended":
                options = replace(options, linearisation="filtered")
            return em.estimate(self.model, self.recordings, noise, unknowns, options).loglik
        except (FilterDivergedError, EstimationError):
            return -np.inf


def upper_bound(profile: Profile, loglik: float, drop: float) -> float | None:
    """Largest standard deviation that the data do not reject, where zero is not rejected either; else None.

    Args:
        profile: the profile over it.
        loglik: log-likelihood of the estimate.
        drop: fall of the log-likelihood at which a value is rejected.
    """
    sd = float(np.sqrt(getattr(profile.noise, profile.letter)[profile.i, profile.i]))
    at_zero = profile.at(sd * ZERO)
    if not at_zero > loglik - drop:
        return None
    least = max(at_zero, loglik) - drop
    return _crossing(profile.at, sd, least)


def _crossing(f: Callable[[float], float], begin: float, least: float) -> float | None:
    """The point above ``begin`` at which f falls through ``least``; None if it does not within the search."""
    low = begin
    for _ in range(FACTORS):
        high = low * FACTOR
        if f(high) < least:
            break
        low = high
    else:
        return None
    while high / low > 1.0 + PRECISION:
        middle = float(np.sqrt(low * high))
        if f(middle) < least:
            high = middle
        else:
            low = middle
    return float(np.sqrt(low * high))

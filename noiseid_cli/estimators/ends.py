"""Is the end of a search a maximum, or has it sat down at zero?

Zero is a fixed point of EM, and a start that is far too small is as good as zero: each step changes it by next to
nothing, which looks like rest. A larger covariance then has the greater likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from noiseid_cli.estimators.unknowns import Unknowns
from noiseid_cli.filters.ekf import FilterDivergedError
from noiseid_cli.filters.gaussian import gaussian_filter
from noiseid_cli.filters.sigma_points import SigmaWeights
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording

# Differences of the log-likelihood below this are no evidence; at a true maximum the first step loses far more.
EVIDENCE = 0.1
# Each step raises the covariance by this, up to the greatest number there is.
STEP, STEPS = 100.0, 300


def false_end(
    model: CompiledModel,
    recordings: Sequence[Recording],
    unknowns: Unknowns,
    noise: NoiseValues,
    loglik: float,
    weights: SigmaWeights | None = None,
) -> str:
    """Name of an unknown covariance that is too small by powers of ten; empty if none is.

    Each unknown covariance is raised step by step until the log-likelihood moves. At a maximum the first step settles
    it, so that the check costs one run of the filter per covariance.

    Args:
        model, recordings, unknowns: the problem.
        noise: the end of a search.
        loglik: its log-likelihood.
        weights: of the sigma-point filter that it is of; None for the extended one.
    """
    for field, structure in (("Q", unknowns.Q), ("R", unknowns.R)):
        if structure is None:
            continue
        raised = noise
        for _ in range(STEPS):
            with np.errstate(over="ignore"):  # where no size moves the likelihood, it goes up to the end of all numbers
                raised = replace(raised, **{field: getattr(raised, field) * STEP})
            if not np.all(np.isfinite(getattr(raised, field))):
                break
            try:
                found = sum(gaussian_filter(model, r, raised, i, weights).loglik for i, r in enumerate(recordings))
            except FilterDivergedError:
                break
            if found > loglik + EVIDENCE:
                return structure.what
            if found < loglik - EVIDENCE:
                break
    return ""

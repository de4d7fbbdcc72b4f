"""Errors of model parameters among those of the noise values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from noiseid_cli.estimators.estimate import Parameters, Uncertainty

METRIC = "parameter"
NONE = "no standard error: it is at a bound, or the data say nothing about it"


def only_parameters(level: float) -> Uncertainty:
    """An uncertainty of no noise value, to which parameters can be added."""
    none = np.zeros(0)
    return Uncertainty("score", level, (), none, none, none, none, (), (), np.zeros((0, 0)), none)


def with_parameters(found: Uncertainty, parameters: Parameters) -> Uncertainty:
    """Add a figure for each parameter, with its standard error and its interval at the same level.

    Args:
        found: how sure the noise values are.
        parameters: with the standard errors that their method gives.
    """
    from scipy.special import ndtri

    errors = parameters.standard_errors
    if errors is None:
        return found
    z = float(ndtri(0.5 + 0.5 * found.level))
    known = np.isfinite(errors)
    ends = np.array([parameters.interval(i, z) for i in range(len(errors))]).reshape(-1, 2)
    positive = np.array(parameters.log_scale or [False] * len(errors))
    lower = np.where(known, ends[:, 0], np.where(positive, 0.0, -np.inf))
    upper = np.where(known, ends[:, 1], np.inf)
    return replace(
        found,
        names=(*found.names, *((METRIC, name, unit) for name, unit, _ in parameters.names)),
        values=np.concatenate((found.values, parameters.final)),
        standard_errors=np.concatenate((found.standard_errors, errors)),
        lower=np.concatenate((found.lower, lower)),
        upper=np.concatenate((found.upper, upper)),
        notes=(*found.notes, *("" if k else NONE for k in known)),
    )

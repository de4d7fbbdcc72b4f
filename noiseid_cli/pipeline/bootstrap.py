"""Parametric bootstrap: how a method's estimates scatter on data simulated at its own estimate.

Efron & Tibshirani, An Introduction to the Bootstrap, 1993, ch. 6 and 13. Intervals are basic ones (2 estimate minus the
quantiles of the replicates) on the scale of each figure, which takes a method's bias away once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from noiseid_cli.errors import EstimationError, NoiseidError
from noiseid_cli.estimators.estimate import Uncertainty

if TYPE_CHECKING:
    from noiseid_cli.estimators.estimate import Estimate, Parameters
    from noiseid_cli.estimators.quantities import Figure
    from noiseid_cli.estimators.unknowns import ParameterUnknowns
    from noiseid_cli.models.recording import Array
    from noiseid_cli.pipeline.methods import Task

STREAM = 3
"""First entry of the spawn key of the streams that replicates are drawn from."""

BIASED = 3.0
"""A mean of the replicates this many of its standard errors off the estimate is called a bias."""


def bootstrap(
    name: str, task: Task, estimate: Estimate, replicates: int, level: float, seed: tuple[int, ...]
) -> Uncertainty:
    """Standard errors from estimates of simulated data, each started from the estimate.

    Args:
        name, task, estimate: the method, what it was given, what it ended with.
        replicates: number of simulated datasets.
        level: confidence level of the intervals.
        seed: seed of the experiment, then whatever tells this unit from others.

    Raises:
        DataError: the simulation in open loop leaves the finite numbers.
        EstimationError: fewer than half of the replicates, or fewer than ten, converged.
    """
    if task.first.given or task.equations.discretisation == "van_loan":
        raise EstimationError(
            "the bootstrap simulates tests from initial_mean and initial_covariance, with noise held over each "
            "interval: a model driven by white noise, initial_map and common_bias are not simulated so"
        )
    shown = _figures(task, estimate)
    found = []
    for b in range(replicates):
        stream = np.random.SeedSequence(seed[0], spawn_key=(STREAM, *seed[1:], b))
        end = _one(name, task, estimate, np.random.default_rng(stream))
        if end is not None:
            found.append([f.value for f in _figures(task, end)])
    if len(found) < max(10, replicates // 2):
        raise EstimationError(f"only {len(found)} of {replicates} bootstrap replicates converged")
    return _gather(shown, np.array(found), replicates, level)


def _figures(task: Task, estimate: Estimate) -> list[Figure]:
    """Noise values, then the scalar unknowns beside them."""
    from noiseid_cli.estimators.parameter_errors import METRIC
    from noiseid_cli.estimators.quantities import Figure, figures

    out = figures(task.model, task.unknowns, estimate.final)
    p = estimate.parameters
    if p is not None:
        positive = p.log_scale or (False,) * len(p.final)
        out += [
            Figure(METRIC, name, unit, float(value), np.zeros(0), "log" if log else "plain", "parameters", (i, i))
            for i, ((name, unit, _), value, log) in enumerate(zip(p.names, p.final, positive, strict=True))
        ]
    return out


def _from_estimate(unknown: ParameterUnknowns, found: Parameters | None) -> ParameterUnknowns:
    """The unknown parameters, to be started from the estimate; one at its bound from where it was started before."""
    if found is None:
        return unknown
    values = {name: value for (name, _, _), value in zip(found.names, found.final, strict=True)}
    start = np.array([values.get(name, own) for name, own in zip(unknown.names, unknown.start, strict=True)])
    inside = (unknown.lower < start) & (start < unknown.upper)
    return replace(unknown, start=np.where(inside, start, unknown.start))


def _one(name: str, task: Task, estimate: Estimate, rng: np.random.Generator) -> Estimate | None:
    """The estimate from one simulated dataset; None if the method does not converge on it."""
    from noiseid_cli.pipeline.methods import run_method
    from noiseid_cli.simulation.replay import replay

    parameters = _from_estimate(task.parameters, estimate.parameters)
    simulated = [replay(task.model, r, estimate.final, i, rng) for i, r in enumerate(task.recordings)]
    try:
        end = run_method(
            name, replace(task, recordings=simulated, start=estimate.final, parameters=parameters, progress=None)
        )
    except NoiseidError:
        return None
    return end if end.status in ("converged", "stalled_fixed_point") else None


def _gather(shown: Sequence[Figure], values: Array, replicates: int, level: float) -> Uncertainty:
    """Spread, intervals and bias of each figure over the replicates (replicates, k)."""
    centre = np.array([f.value for f in shown])
    errors = values.std(axis=0, ddof=1)
    tail = 0.5 * (1.0 - level)
    ends = []
    for figure, column in zip(shown, values.T, strict=True):
        on_scale = _scaled(figure.scale, column)
        middle = float(_scaled(figure.scale, np.array([figure.value]))[0])
        high, low = np.quantile(on_scale, [1.0 - tail, tail])
        ends.append((_back(figure.scale, 2.0 * middle - high), _back(figure.scale, 2.0 * middle - low)))
    bias = values.mean(axis=0) - centre
    off = np.abs(bias) > BIASED * errors / np.sqrt(len(values))
    notes = tuple(f"biased: replicates average {centre[k] + bias[k]:.4g}" if off[k] else "" for k in range(len(shown)))
    remarks = [f"{replicates - len(values)} of {replicates} replicates did not converge and are left out."]
    return Uncertainty(
        method="bootstrap",
        level=level,
        names=tuple((f.metric, f.index, f.unit) for f in shown),
        values=centre,
        standard_errors=errors,
        lower=np.array([low for low, _ in ends]),
        upper=np.array([high for _, high in ends]),
        notes=notes,
        coordinates=(),
        information=np.zeros((0, 0)),
        shares=np.zeros(0),
        remarks=tuple(remarks) if len(values) < replicates else (),
    )


def _scaled(scale: str, values: Array) -> Array:
    if scale == "log":
        return np.log(values)
    return np.arctanh(values) if scale == "fisher" else values


def _back(scale: str, value: float) -> float:
    if scale == "log":
        return float(np.exp(value))
    return float(np.tanh(value)) if scale == "fisher" else float(value)

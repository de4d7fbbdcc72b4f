"""The filters that an estimate is judged by: at its start, at its end and at the truth, on its data and on others."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.pipeline.context import Context
from noiseid_cli.pipeline.first_state import simulated
from noiseid_cli.pipeline.methods import filter_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from noiseid_cli.config.method_base import MethodOptions
    from noiseid_cli.diagnostics.evaluation import Evaluation
    from noiseid_cli.estimators.estimate import Estimate, Parameters
    from noiseid_cli.models.compiled import CompiledModel
    from noiseid_cli.models.equations import Model
    from noiseid_cli.models.recording import Array, Dataset, Recording

Candidates = dict[str, tuple["Model", NoiseValues]]
"""By label, a model with the parameters in force there, and the noise values."""


def candidates(context: Context, dataset: Dataset, estimate: Estimate) -> Candidates:
    """What the filter is run with: ``tuning`` if given, ``start``, ``estimate`` and, of simulated data, ``truth``."""
    model, found = context.model, estimate.parameters
    at_start = model if found is None else _with(model, found, found.start)
    out = in_use(context, estimate.start)
    out |= {"start": (at_start, estimate.start), "estimate": (at_estimate(model, estimate), estimate.final)}
    if dataset.Q_true is not None and dataset.R_true is not None:
        out["truth"] = (model, _true_noise(context, dataset, estimate))
    return out


def in_use(context: Context, start: NoiseValues) -> Candidates:
    """The covariances in use today, where the experiment gives them, with the start's law of the first state."""
    section = context.experiment.estimate
    if section is None or section.tuning is None:
        return {}
    Q, R = section.tuning.process_noise.matrix(), section.tuning.measurement_noise.matrix()
    return {"tuning": (context.model, replace(start, Q=Q, R=R))}


def evaluate_all(
    context: Context,
    recordings: Sequence[Recording],
    wanted: Candidates,
    options: MethodOptions,
    first: Sequence[int] | None = None,
) -> dict[str, Evaluation]:
    """The method's own filter with each candidate against data; those with which it fails are left out.

    Args:
        context, recordings, wanted: the problem.
        options: of the method, which say which filter is its own.
        first: per test, the first sample that counts, see ``diagnostics.evaluate``.
    """
    from noiseid_cli.diagnostics.evaluate import evaluate
    from noiseid_cli.filters.ekf import FilterDivergedError

    own, weights = filter_of(options, context.compiled.nx)
    out = {}
    for label, (model, noise) in wanted.items():
        posed = _filter_model(context, model, noise, recordings)
        if posed is None:
            continue
        try:
            out[label] = evaluate(posed[0], recordings, posed[1], label, own, weights, first)
        except FilterDivergedError:
            continue
    return out


def evaluate_end(
    context: Context, dataset: Dataset, fitted: Dataset, wanted: Candidates, options: MethodOptions
) -> dict[str, Evaluation]:
    """The same on the ends of the tests that are held out: the filter runs on from the fitted part's end.

    Args:
        context, wanted, options: as in ``evaluate_all``.
        dataset: the whole tests.
        fitted: their fitted parts, outliers among them left out.
    """
    pairs = list(zip(dataset.recordings, fitted.recordings, strict=True))
    joined = tuple(replace(whole, y=np.vstack([part.y, whole.y[part.samples :]])) for whole, part in pairs)
    return evaluate_all(context, joined, wanted, options, [part.samples for _, part in pairs])


def on_other_tests(wanted: Candidates, m0: Array, estimated: bool) -> Candidates:
    """The candidates for tests with first states of their own: ``m0``, or the one mean that was estimated."""
    return {
        label: (model, replace(noise, m0=np.tile(noise.m0[0], (len(m0), 1)) if estimated else m0))
        for label, (model, noise) in wanted.items()
    }


def at_estimate(model: Model, estimate: Estimate) -> Model:
    """The model with the parameters that were estimated."""
    found = estimate.parameters
    return model if found is None else _with(model, found, found.final)


def _with(model: Model, found: Parameters, values: Array) -> Model:
    """The model with some parameters replaced; unknowns that are none of its parameters are passed over."""
    out = copy(model)
    pairs = zip(found.names, values.tolist(), strict=True)
    own = {name: value for (name, _, _), value in pairs if name in model.values}
    out.values = model.values | own
    return out


def compiled_at(context: Context, model: Model) -> CompiledModel:
    """The compiled model with the parameters of ``model``; what it holds beyond them stays."""
    own = model.vector
    return context.compiled.with_parameters(range(len(own)), own)


def _true_noise(context: Context, dataset: Dataset, estimate: Estimate) -> NoiseValues:
    """True covariances, with the law of the first state: the true one where one is simulated, else the start's."""
    assert dataset.Q_true is not None
    assert dataset.R_true is not None
    section = context.experiment.simulate
    noise = NoiseValues(dataset.Q_true, dataset.R_true, estimate.start.m0, estimate.start.P0)
    if section is None or section.initial_covariance is None:
        return noise
    law = simulated(context, dataset.Q_true, dataset.R_true)[2]
    return replace(noise, m0=np.tile(law.m0, (len(dataset.recordings), 1)), P0=law.P0)


def _filter_model(
    context: Context, model: Model, noise: NoiseValues, recordings: Sequence[Recording]
) -> tuple[CompiledModel, NoiseValues] | None:
    """The compiled model of a filter and its noise; None for white noise over intervals that differ."""
    if model.discretisation != "van_loan":
        return compiled_at(context, model), noise
    from noiseid_cli.models.linear_family import LinearFamily

    found = LinearFamily(model, (), noise.Q, noise.R).filter_model(np.empty(0), recordings)
    return None if found is None else (found[0], replace(noise, Q=found[1]))

"""The `estimate` stage: run one method from one start on one dataset, and write what came of it."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from noiseid_cli.estimators.estimate import Estimate, Parameters, Progress
from noiseid_cli.filters.gate import OutlierGate
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.outcome import UnitResult
from noiseid_cli.pipeline.context import Context
from noiseid_cli.pipeline.datasets import file_attributes
from noiseid_cli.pipeline.methods import Task, filter_of, run_method
from noiseid_cli.pipeline.noise_unit import conversion_interval, noise_names
from noiseid_cli.pipeline.outliers import fit_without_outliers
from noiseid_cli.pipeline.problem import check_time_constants, pose, pose_parameters
from noiseid_cli.pipeline.unit import EstimateUnit

if TYPE_CHECKING:
    from noiseid_cli.config.methods import MethodOptions
    from noiseid_cli.diagnostics.evaluation import Evaluation
    from noiseid_cli.estimators.unknowns import ParameterUnknowns, Unknowns
    from noiseid_cli.models.compiled import CompiledModel
    from noiseid_cli.models.recording import Array, Dataset

    Candidates = dict[str, tuple[NoiseValues, CompiledModel]]


def make_estimate(context: Context, unit: EstimateUnit, progress: Progress | None = None) -> UnitResult:
    """Run one unit and write its result; a method that diverges is a result too.

    Raises:
        DataError: the dataset is missing or damaged.
        EstimationError: the problem cannot be posed.
    """
    from noiseid_cli.diagnostics.data_properties import rounding_warnings
    from noiseid_cli.storage.result_file import write_result

    began = time.perf_counter()
    dataset = _read(context, unit.dataset.path)
    section = context.experiment.estimate
    assert section is not None
    if unit.options.structure is not None:
        own = section.process_noise.model_copy(update={"structure": unit.options.structure})
        section = section.model_copy(update={"process_noise": own})
    check_time_constants(context.experiment.model.markov_noise, context.model.discretisation, dataset)
    start, unknowns = pose(section, dataset, context.compiled, unit.start.factors, unit.start.measurement_factor)
    parameters = pose_parameters(section)

    def fit(used: Dataset) -> Estimate:
        return _run(context, used, start, (unknowns, parameters), unit.options, progress)

    if section.outlier_gate is None:
        estimate = fit(dataset)
    else:
        gate = OutlierGate(**section.outlier_gate.model_dump())
        estimate, dataset = fit_without_outliers(fit, lambda e: _at_end(context, e), dataset, gate)
    structure = section.process_noise.structure
    words = structure if isinstance(structure, str) else "blocks"
    warned = rounding_warnings(dataset, estimate.final.R) if unit.dataset.recordings else []
    estimate = replace(
        estimate,
        settings={"structure": words, **estimate.settings},
        safeguards=(*estimate.safeguards, *warned),
    )
    found = estimate.parameters
    candidates = {
        "start": (start, _with(context, found, None if found is None else found.start)),
        "estimate": (estimate.final, _at_end(context, estimate)),
    }
    if dataset.Q_true is not None and dataset.R_true is not None:
        candidates["truth"] = (NoiseValues(dataset.Q_true, dataset.R_true, start.m0, start.P0), context.compiled)
    held_out = None if unit.held_out is None else _read(context, unit.held_out.path)
    result = UnitResult(
        unit=unit.own_name,
        dataset=dataset.name,
        method_label=unit.label,
        start_index=unit.start.index,
        start_label=unit.start.label,
        replicate=unit.dataset.replicate,
        estimate=estimate,
        evaluations=_evaluate(context, dataset, candidates, unit.options),
        noise_names=noise_names(context.model, context.density),
        output_names=dataset.outputs,
        state_names=dataset.states,
        test_names=tuple(r.name for r in dataset.recordings),
        Q_true=dataset.Q_true,
        R_true=dataset.R_true,
        seconds=time.perf_counter() - began,
        seed=context.experiment.seed,
        held_out={} if held_out is None else _score(context, held_out, candidates, unit.options),
        held_out_tests=0 if held_out is None else len(held_out.recordings),
        parameters_true=_true_parameters(context, dataset, estimate),
        density=context.density,
        interval=conversion_interval(dataset, context.model, context.density),
    )
    write_result(unit.path, result, file_attributes(context, unit.key) | _basis(context, dataset, estimate))
    return result


def _basis(context: Context, dataset: Dataset, estimate: Estimate) -> dict[str, str]:
    """What the estimate holds for: the model with its parameter values, and the intervals between samples, s."""
    model, found = context.model, estimate.parameters
    own = {} if found is None else dict(zip((n for n, _, _ in found.names), found.final.tolist(), strict=True))
    dt = np.concatenate([recording.dt for recording in dataset.recordings])
    return {
        "model": json.dumps(
            {
                "name": model.name,
                "discretisation": model.discretisation,
                "parameters": [
                    {"name": p.name, "value": own.get(p.name, p.value), "unit": p.unit}
                    for p in model.parameters_in_force
                ],
            },
            ensure_ascii=False,
        ),
        "sample_time": json.dumps(
            {"median": float(np.median(dt)), "shortest": float(dt.min()), "longest": float(dt.max()), "unit": "s"}
            if len(dt)
            else {"median": None, "shortest": None, "longest": None, "unit": "s"}
        ),
    }


def _at_end(context: Context, estimate: Estimate) -> CompiledModel:
    """The model at the parameter values of an estimate."""
    found = estimate.parameters
    return _with(context, found, None if found is None else found.final)


def _with(context: Context, parameters: Parameters | None, values: Array | None) -> CompiledModel:
    """The model with the values of those of its parameters that were estimated."""
    if parameters is None or values is None:
        return context.compiled
    vector, known = context.compiled.parameters.copy(), list(context.model.values)
    for (name, _, _), value in zip(parameters.names, values, strict=True):
        if name in known:
            vector[known.index(name)] = value
    return replace(context.compiled, parameters=vector)


def _read(context: Context, path: Path) -> Dataset:
    """A dataset with the true Q, which is stored per sample, in the unit of the estimate."""
    from noiseid_cli.storage.dataset_file import read_dataset

    dataset = read_dataset(path)
    if not context.density or dataset.Q_true is None:
        return dataset
    # Only simulated tests have one, and their intervals are equal.
    return replace(dataset, Q_true=dataset.Q_true * context.model.sample_time)


def _run(
    context: Context,
    dataset: Dataset,
    start: NoiseValues,
    unknowns: tuple[Unknowns, ParameterUnknowns],
    options: MethodOptions,
    progress: Progress | None,
) -> Estimate:
    """Call the method; a filter that fails at the start itself makes a result with status `diverged`."""
    from noiseid_cli.filters.ekf import FilterDivergedError

    settings = options.model_dump(exclude={"method", "structure"})
    try:
        task = Task(context.compiled, context.model, dataset.recordings, start, *unknowns, settings, progress)
        return run_method(options.method, task)
    except FilterDivergedError as error:
        return Estimate(
            method=options.method,
            status="diverged",
            reason=f"the filter fails at the start values: {error}",
            start=start,
            final=start,
            loglik_start=np.nan,
            loglik=np.nan,
            passes=0,
            seconds=0.0,
            settings=settings,
        )


def _true_parameters(context: Context, dataset: Dataset, estimate: Estimate) -> Array | None:
    """Truth of the estimated scalars: the model's own values, or those at the end of a test in which they change."""
    if estimate.parameters is None or context.experiment.simulate is None:
        return None
    values = dict(context.model.values)
    if (path := dataset.recordings[-1].parameters_true) is not None:
        values |= zip((name for name, _, _ in dataset.parameters), path[-1].tolist(), strict=True)
    return np.array([values.get(name, np.nan) for name, _, _ in estimate.parameters.names])


def _evaluate(
    context: Context, dataset: Dataset, candidates: Candidates, options: MethodOptions
) -> dict[str, Evaluation]:
    """The method's own filter with each of the values against the data; those with which it fails are left out."""
    from noiseid_cli.diagnostics.evaluate import evaluate
    from noiseid_cli.filters.ekf import FilterDivergedError

    own, weights = filter_of(options, context.compiled.nx)
    out = {}
    for label, (noise, model) in candidates.items():
        try:
            out[label] = evaluate(model, dataset.recordings, noise, label, own, weights)
        except FilterDivergedError:
            continue
    return out


def _score(
    context: Context, held_out: Dataset, candidates: Candidates, options: MethodOptions
) -> dict[str, Evaluation]:
    """The same on tests that no method has seen, which have first states of their own."""
    section = context.experiment.estimate
    assert section is not None
    m0 = pose(section, held_out, context.compiled)[0].m0
    moved = {label: (replace(noise, m0=m0), model) for label, (noise, model) in candidates.items()}
    return _evaluate(context, held_out, moved, options)

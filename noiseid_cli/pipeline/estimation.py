"""The `estimate` stage: run one method from one start on one dataset, and write what came of it."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.estimate import Estimate, Progress
from noiseid_cli.filters.gate import OutlierGate
from noiseid_cli.outcome import UnitResult
from noiseid_cli.pipeline.assessment import assess_uncertainty, fitted_part
from noiseid_cli.pipeline.context import Context
from noiseid_cli.pipeline.datasets import file_attributes
from noiseid_cli.pipeline.ensembles import FirstStateLaw
from noiseid_cli.pipeline.evaluating import (
    Candidates,
    at_estimate,
    candidates,
    compiled_at,
    evaluate_all,
    evaluate_end,
    on_other_tests,
)
from noiseid_cli.pipeline.first_state import first_names
from noiseid_cli.pipeline.methods import ENSEMBLES, Task, run_method
from noiseid_cli.pipeline.noise_unit import conversion_interval, noise_names
from noiseid_cli.pipeline.outliers import fit_without_outliers
from noiseid_cli.pipeline.problem import check_sample_time, check_time_constants, pose, pose_parameters
from noiseid_cli.pipeline.truth import true_parameters
from noiseid_cli.pipeline.unit import EstimateUnit
from noiseid_cli.pipeline.units import earlier_result

if TYPE_CHECKING:
    from noiseid_cli.config.method_base import MethodOptions
    from noiseid_cli.config.schema_estimate import Estimate as Section
    from noiseid_cli.diagnostics.evaluation import Evaluation
    from noiseid_cli.models.compiled import CompiledModel
    from noiseid_cli.models.recording import Dataset


def make_estimate(context: Context, unit: EstimateUnit, progress: Progress | None = None) -> UnitResult:
    """Run one unit and write its result; a method that diverges is a result too.

    Raises:
        DataError: the dataset is missing or damaged.
        EstimationError: the problem cannot be posed.
    """
    from noiseid_cli.storage.result_file import write_result

    began = time.perf_counter()
    dataset = selected(context, _read(context, unit.dataset.path))
    assert context.experiment.estimate is not None
    section = with_structure(context.experiment.estimate, unit.options)
    check_time_constants(context.experiment.model.markov_noise, context.model.discretisation, dataset)
    check_sample_time(context.model, dataset)
    first = first_names(context)
    start, unknowns = pose(section, dataset, context.compiled, unit.start.factors, unit.start.measurement_factor, first)
    fitted = fitted_part(section, dataset)
    settings = unit.options.model_dump(exclude={"method", "structure"})
    law, state = FirstStateLaw.of(section), _state(context)
    task = Task(
        context.compiled, context.model, fitted.recordings, start, unknowns, pose_parameters(section), settings,
        progress, law, state,
    )  # fmt: skip
    estimate, fitted = _fit(context, section, unit.options.method, task, fitted)
    at_end = replace(task, model=_model_at(context, estimate), recordings=fitted.recordings)
    place = (context.experiment.seed, unit.dataset.replicate, unit.start.index)
    sure, why_not = assess_uncertainty(section, unit.options, at_end, estimate, place)
    warned = _implausible(context, fitted, estimate) if unit.dataset.recordings else []
    estimate = replace(
        estimate,
        settings={"structure": _structure(section), **estimate.settings},
        safeguards=(*estimate.safeguards, *warned, *why_not),
    )
    wanted = candidates(context, dataset, estimate)
    held_out = None if unit.held_out is None else _read(context, unit.held_out.path)
    scored = {} if held_out is None else _score(context, held_out, wanted, unit.options)
    if section.holdout is not None:
        scored = evaluate_end(context, dataset, fitted, wanted, unit.options)
    result = UnitResult(
        unit=unit.own_name,
        dataset=dataset.name,
        method_label=unit.label,
        start_index=unit.start.index,
        start_label=unit.start.label,
        replicate=unit.dataset.replicate,
        estimate=estimate,
        evaluations=evaluate_all(context, fitted.recordings, wanted, unit.options),
        noise_names=noise_names(context.model, context.density),
        output_names=dataset.outputs,
        state_names=dataset.states,
        test_names=tuple(r.name for r in dataset.recordings),
        Q_true=dataset.Q_true,
        R_true=dataset.R_true,
        seconds=time.perf_counter() - began,
        seed=context.experiment.seed,
        held_out=scored,
        held_out_tests=len((held_out or dataset).recordings) if scored else 0,
        parameters_true=true_parameters(context, dataset, estimate),
        density=context.density,
        interval=conversion_interval(dataset, context.model, context.density),
        uncertainty=sure,
        Q_tuning=wanted["tuning"][1].Q if "tuning" in wanted else None,
        R_tuning=wanted["tuning"][1].R if "tuning" in wanted else None,
    )
    write_result(unit.path, result, file_attributes(context, unit.key) | _basis(context, dataset, estimate))
    return result


def _fit(context: Context, section: Section, method: str, task: Task, fitted: Dataset) -> tuple[Estimate, Dataset]:
    """The estimate, and the data that it rests on: those given, or what the outlier gate leaves of them."""

    def fit(used: Dataset) -> Estimate:
        return _run(method, replace(task, recordings=used.recordings))

    if section.outlier_gate is None:
        return fit(fitted), fitted
    if method in ENSEMBLES:
        raise EstimationError(f"outlier_gate does not go with {method}")
    gate = OutlierGate(**section.outlier_gate.model_dump())
    return fit_without_outliers(fit, lambda e: _model_at(context, e), fitted, gate)


def _structure(section: Section) -> str:
    """The structure of the process noise, in a word."""
    structure = section.process_noise.structure
    return structure if isinstance(structure, str) else "blocks"


def _implausible(context: Context, fitted: Dataset, estimate: Estimate) -> list[str]:
    """What of the noise is too small or too large to be what its name says."""
    from noiseid_cli.diagnostics.data_properties import rounding_warnings, size_warnings

    interval = conversion_interval(fitted, context.model, context.density) if context.density else 1.0
    per_sample = estimate.final.Q / (interval or 1.0)
    noises = noise_names(context.model, density=False)
    return rounding_warnings(fitted, estimate.final.R) + size_warnings(fitted, noises, per_sample)


def with_structure(section: Section, options: MethodOptions) -> Section:
    """The `estimate` section as a method takes it, whose structure of the process noise may be its own."""
    if options.structure is None:
        return section
    own = section.process_noise.model_copy(update={"structure": options.structure})
    return section.model_copy(update={"process_noise": own})


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


def _read(context: Context, path: Path) -> Dataset:
    """A dataset as the methods take it."""
    from noiseid_cli.storage.dataset_file import read_dataset

    return in_unit_of_estimate(context, read_dataset(path))


def in_unit_of_estimate(context: Context, dataset: Dataset) -> Dataset:
    """The dataset with the true Q, which is stored per sample, in the unit of the estimate."""
    if not context.density or dataset.Q_true is None:
        return dataset
    # Only simulated tests have one, and their intervals are equal.
    return replace(dataset, Q_true=dataset.Q_true * context.model.sample_time)


def _run(method: str, task: Task) -> Estimate:
    """Call the method; a filter that fails at the start itself makes a result with status `diverged`."""
    from noiseid_cli.filters.ekf import FilterDivergedError

    try:
        return run_method(method, task)
    except FilterDivergedError as error:
        return Estimate(
            method=method,
            status="diverged",
            reason=f"the filter fails at the start values: {error}",
            start=task.start,
            final=task.start,
            loglik_start=np.nan,
            loglik=np.nan,
            passes=0,
            seconds=0.0,
            settings=task.options,
        )


def _model_at(context: Context, estimate: Estimate) -> CompiledModel:
    """The compiled model at the parameter values of an estimate."""
    return compiled_at(context, at_estimate(context.model, estimate))


def _state(context: Context) -> dict[str, np.ndarray[Any, Any]]:
    """What the earlier result left to go on from; nothing where the experiment names none.

    Raises:
        EstimationError: it left nothing.
    """
    from noiseid_cli.storage.result_file import read_result

    path = earlier_result(context)
    if path is None:
        return {}
    state = read_result(path).estimate.state
    if not state:
        raise EstimationError(f"{path} is a result that nothing goes on from: name one of recursive-ml")
    return state


def _score(context: Context, held_out: Dataset, wanted: Candidates, options: MethodOptions) -> dict[str, Evaluation]:
    """The filters on tests that no method has seen, which have first states of their own."""
    section = context.experiment.estimate
    assert section is not None
    m0 = pose(section, held_out, context.compiled, first=first_names(context))[0].m0
    moved = on_other_tests(wanted, m0, section.initial_mean.start is not None)
    return evaluate_all(context, held_out.recordings, moved, options)


def selected(context: Context, dataset: Dataset) -> Dataset:
    """The dataset with the tests that are used.

    Raises:
        EstimationError: it has no such tests.
    """
    section = context.experiment.estimate
    assert section is not None
    chosen, count = section.tests, len(dataset.recordings)
    last = count if chosen.last is None else chosen.last
    if max(chosen.first, last) > count:
        raise EstimationError(
            f"estimate.tests asks for tests {chosen.first} to {last}, but dataset {dataset.name} has {count}"
        )
    return replace(dataset, recordings=dataset.recordings[chosen.first - 1 : last])

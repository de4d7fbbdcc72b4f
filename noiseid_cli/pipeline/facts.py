"""What a report says about model, data and published figures, besides the results."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from noiseid_cli.pipeline.context import Context

if TYPE_CHECKING:
    from noiseid_cli.config.published import Published
    from noiseid_cli.models.recording import Dataset
    from noiseid_cli.outcome import UnitResult
    from noiseid_cli.pipeline.unit import EstimateUnit
    from noiseid_cli.report import DatasetFacts, ModelFacts, PublishedEstimates, PublishedFacts, SweepFacts


def model_facts(context: Context) -> ModelFacts:
    """The model in words, with its equations and parameters."""
    from noiseid_cli.models.describe import describe
    from noiseid_cli.report import EquationFact, ModelFacts, ParameterFact

    description = describe(context.model)
    return ModelFacts(
        name=description.name,
        description=description.summary,
        equations=tuple(EquationFact(e.kind, e.text, e.mathml) for e in description.equations),
        parameters=tuple(
            ParameterFact(p.name, p.value, p.unit, p.description, p.source) for p in context.model.parameters_in_force
        ),
    )


def dataset_facts(context: Context, dataset: Dataset) -> DatasetFacts:
    """A dataset in words and sizes."""
    import numpy as np

    from noiseid_cli.report import DatasetFacts

    values = sum(r.y.size for r in dataset.recordings)
    missing = sum(int(np.isnan(r.y).sum()) for r in dataset.recordings)
    units = {unit for _, unit, _ in dataset.performances}
    simulated = context.experiment.simulate
    return DatasetFacts(
        name=dataset.name,
        origin="imported" if simulated is None else f"simulated, trajectory {simulated.trajectory.kind}",
        tests=len(dataset.recordings),
        samples=sum(r.samples for r in dataset.recordings),
        duration=float(sum(r.dt.sum() for r in dataset.recordings)),
        missing_share=missing / values,
        notes=dataset.notes,
        times=tuple(r.time for r in dataset.recordings),
        performance_unit=units.pop() if len(units) == 1 else "",
        held=_held(context) if len(dataset.recordings) == 1 else None,
        steps={} if simulated is not None else _steps(dataset),
    )


def _steps(dataset: Dataset) -> dict[str, float]:
    """The quantisation step of each output that has one."""
    from noiseid_cli.diagnostics.data_properties import output_steps

    pairs = zip(dataset.outputs, output_steps(dataset), strict=True)
    return {name: step for (name, _, _), step in pairs if step is not None}


def _held(context: Context) -> tuple[float, float] | None:
    """The rest that the motion of a simulation asks for, s."""
    simulated = context.experiment.simulate
    if simulated is None or simulated.trajectory.kind != "s_curve" or simulated.trajectory.hold is None:
        return None
    return simulated.trajectory.hold.begin, simulated.trajectory.hold.end


def claim_sentences(published: Published) -> list[str]:
    """What a source claims, each with what was found where that is written down."""
    return [
        c if isinstance(c, str) else f"{c.claim} Found by the shipped experiment: {c.found}" for c in published.claims
    ]


def published_facts(context: Context) -> tuple[list[PublishedFacts], PublishedEstimates | None, list[str]]:
    """Published tables and estimates to stand beside ours, and what their source claims."""
    from noiseid_cli.config.published import load_published
    from noiseid_cli.report import PublishedEstimates, PublishedFacts

    file = context.experiment.report.published
    if file is None:
        return [], None, []
    published = load_published(context.loaded.resolve(file))
    facts = [
        PublishedFacts(
            name,
            t.title,
            t.metric,
            t.index,
            t.unit,
            {str(k): v for k, v in t.rows.items()},
            t.note or "",
            published.source,
        )
        for name, t in published.tables.items()
    ]
    own = published.estimates
    if own is None:
        return facts, None, claim_sentences(published)
    methods = {label: {name: (v.value, v.error) for name, v in row.items()} for label, row in own.methods.items()}
    estimates = PublishedEstimates(own.title, methods, own.note or "", published.source)
    return facts, estimates, claim_sentences(published)


def named_at_point(result: UnitResult, unit: EstimateUnit) -> UnitResult:
    """A result under the names of its unit, which hold the point of the sweep."""
    return replace(result, unit=unit.name, dataset=unit.dataset.name)


def sweep_facts(context: Context, units: Sequence[EstimateUnit]) -> SweepFacts | None:
    """What was varied, and the values for each of the units; None without a sweep."""
    from noiseid_cli.report import SweepFacts

    sweep = context.experiment.sweep
    if sweep is None:
        return None
    values = {}
    for unit in units:
        assert unit.point_index is not None
        values[unit.name] = tuple(_cell(v) for v in context.points[unit.point_index].values.values())
    settings = tuple(", ".join(axis.vary) for axis in sweep.axes.values())
    return SweepFacts(tuple(sweep.axes), settings, values)


def _cell(value: Any) -> float | int | str:
    """A number as it is; anything else as the text that a config would have."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return value
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)

"""The `report` stage: gather the results of an experiment and write its report."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from noiseid_cli.errors import DataError
from noiseid_cli.pipeline.context import Context
from noiseid_cli.pipeline.units import EstimateUnit, estimate_units

if TYPE_CHECKING:
    from noiseid_cli.models.recording import Dataset
    from noiseid_cli.report import DatasetFacts, ModelFacts, ReportFiles, Study
    from noiseid_cli.report.tables import Table


@dataclass(frozen=True)
class Reported:
    """A report that was written.

    Attributes:
        files: what was written and where.
        tables: the main tables, for the terminal.
        unfinished: number of results that did not converge.
    """

    files: ReportFiles
    tables: list[Table]
    unfinished: int


def make_report_stage(context: Context, methods: list[str] | None = None) -> Reported:
    """Write the report of all results that are there.

    Args:
        context: the experiment.
        methods: as in ``estimate_units``.

    Raises:
        DataError: there is no result yet, or one is damaged.
    """
    from noiseid_cli.report import make_report, terminal_tables

    study = gather(context, methods)
    files = make_report(study, context.folder / "report", context.experiment.report.formats)
    unfinished = sum(r.estimate.status != "converged" for r in study.results)
    return Reported(files, terminal_tables(study), unfinished)


def gather(context: Context, methods: list[str] | None = None) -> Study:
    """Everything that the report shows."""
    from noiseid_cli.report import Study
    from noiseid_cli.storage.dataset_file import read_dataset
    from noiseid_cli.storage.provenance import provenance
    from noiseid_cli.storage.result_file import read_result

    units = estimate_units(context, methods)
    done = [unit for unit in units if unit.done]
    if not done:
        raise DataError(f"there are no results of this experiment under {context.folder}: run `noiseid estimate` first")
    datasets = list({unit.dataset.name: unit.dataset for unit in done}.values())
    return Study(
        title=context.experiment.report.title or context.experiment.experiment,
        experiment=context.experiment.experiment,
        results=[read_result(unit.path) for unit in done],
        model=_model_facts(context),
        datasets=[_dataset_facts(context, read_dataset(unit.path)) for unit in datasets if unit.done],
        environment=provenance(),
        reproduce=_reproduce(context),
        warnings=_warnings(units, done),
        citations=citations(context, done),
    )


def _warnings(units: Sequence[EstimateUnit], done: Sequence[EstimateUnit]) -> list[str]:
    missing = [unit.name for unit in units if not unit.done]
    if not missing:
        return []
    return [f"{len(missing)} of {len(units)} results are missing, the first is {missing[0]}."]


def _reproduce(context: Context) -> list[str]:
    """The settings as they were, so that the page alone is enough to get the same numbers again."""
    settings = json.dumps(context.loaded.resolved(), indent=1)
    return ["Save these settings as experiment.yaml (JSON is YAML) and run `noiseid run experiment.yaml`:", settings]


def citations(context: Context, units: Sequence[EstimateUnit] | None = None) -> list[str]:
    """The works behind the methods and the model of an experiment."""
    from noiseid_cli.config.methods import METHOD_OPTIONS

    units = estimate_units(context) if units is None else units
    papers = [METHOD_OPTIONS[name].citation for name in dict.fromkeys(unit.options.method for unit in units)]
    return list(dict.fromkeys([*papers, *([context.model.citation] if context.model.citation else [])]))


def _model_facts(context: Context) -> ModelFacts:
    from noiseid_cli.models.describe import describe
    from noiseid_cli.report import ModelFacts, ParameterFact

    description = describe(context.model)
    return ModelFacts(
        name=description.name,
        description=description.summary,
        equations=tuple(equation.text for equation in description.equations),
        parameters=tuple(
            ParameterFact(p.name, p.value, p.unit, p.description, p.source) for p in context.model.parameters_in_force
        ),
    )


def _dataset_facts(context: Context, dataset: Dataset) -> DatasetFacts:
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
    )

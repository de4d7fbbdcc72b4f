"""The `diagnose` command's work: does a filter agree with the data, for results that are there or before any."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from noiseid_cli.errors import DataError
from noiseid_cli.pipeline.context import Context

if TYPE_CHECKING:
    from noiseid_cli.report.diagnosis import Case
    from noiseid_cli.report.tables import Table

DEFAULT = ("estimate", "tuning", "start")
"""Which noise values are looked at, the first that are there."""


@dataclass(frozen=True)
class Diagnosis:
    """Tables, and what they say.

    Attributes:
        tables: on the whole, per output, and where in the motion.
        sentences: per case, its name and what is left unexplained.
        at: the noise values that were looked at closely.
    """

    tables: list[Table]
    sentences: list[tuple[str, list[str]]]
    at: str


def diagnose_result(path: Path, at: str | None = None) -> Diagnosis:
    """Diagnose one result file.

    Raises:
        DataError: it cannot be read, or has no filter at the values asked for.
    """
    from noiseid_cli.report.diagnosis import case_of
    from noiseid_cli.storage.result_file import read_result

    return _diagnose([case_of(read_result(path))], at)


def diagnose_experiment(context: Context, methods: list[str] | None = None, at: str | None = None) -> Diagnosis:
    """Diagnose all results of an experiment; without any, the start and the tuning on the datasets that are there.

    Raises:
        DataError: neither results nor datasets are there; it names the command that makes them.
        EstimationError: the experiment says nothing of the noise.
    """
    from noiseid_cli.pipeline.units import estimate_units
    from noiseid_cli.report.diagnosis import case_of
    from noiseid_cli.storage.result_file import read_result

    units = estimate_units(context, methods)
    done = [unit for unit in units if unit.done]
    cases = [case_of(read_result(unit.path), _interval(context)) for unit in done] or _before(context)
    return _diagnose(cases, at)


def _interval(context: Context) -> float | None:
    """The model's own interval, to tell lags as times; that of recordings may differ."""
    return context.model.sample_time if context.experiment.simulate is not None else None


def _before(context: Context) -> list[Case]:
    """The filter at the start, the tuning and the truth, on each dataset."""
    from noiseid_cli.config.methods import EmOptions
    from noiseid_cli.pipeline.assessment import fitted_part
    from noiseid_cli.pipeline.evaluating import evaluate_all, evaluate_end, in_use
    from noiseid_cli.pipeline.first_state import first_names
    from noiseid_cli.pipeline.problem import pose
    from noiseid_cli.pipeline.units import data_stage, dataset_units
    from noiseid_cli.report.diagnosis import Case
    from noiseid_cli.storage.dataset_file import read_dataset

    section = context.experiment.estimate
    assert section is not None
    units = [unit for unit in dataset_units(context) if unit.done and not unit.held_out]
    if not units:
        raise DataError(f"there is no dataset of these settings: run `noiseid {data_stage(context)}` first")
    context.say("diagnose: no results yet; the filter runs with the values that the experiment gives")
    cases = []
    for unit in units:
        dataset = read_dataset(unit.path)
        start, _ = pose(section, dataset, context.compiled, first=first_names(context))
        wanted = {**in_use(context, start), "start": (context.model, start)}
        if dataset.Q_true is not None and dataset.R_true is not None:
            wanted["truth"] = (context.model, replace(start, Q=dataset.Q_true, R=dataset.R_true))
        fitted, own = fitted_part(section, dataset), EmOptions()
        held_out = {} if section.holdout is None else evaluate_end(context, dataset, fitted, wanted, own)
        found = evaluate_all(context, fitted.recordings, wanted, own)
        cases.append(Case(dataset.name, dataset.outputs, found, held_out, _interval(context)))
    return cases


def _diagnose(cases: Sequence[Case], at: str | None) -> Diagnosis:
    from noiseid_cli.report.diagnosis import output_table, overall_table, verdict, where_table

    known = [label for label in ("estimate", "tuning", "start", "truth") if any(label in c.evaluations for c in cases)]
    chosen = at or next((label for label in DEFAULT if label in known), None)
    if chosen is None or chosen not in known:
        have = f"there are: {', '.join(known)}" if known else "the filter failed with all of them"
        raise DataError(f"no filter was run at the {at or 'estimated'} values; {have}")
    tables = [overall_table(cases), output_table(cases, chosen)]
    where = where_table(cases, chosen)
    tables += [where] if where else []
    return Diagnosis(tables, [(case.name, verdict(case, chosen)) for case in cases], chosen)

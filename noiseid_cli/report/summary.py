"""The few tables that a terminal shows at the end of a run."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from noiseid_cli.report.agreement import consistency_table, start_groups, starts_table
from noiseid_cli.report.build import (
    MANY,
    before_after_table,
    ending_table,
    std_summary_table,
    std_table,
    summary_table,
)
from noiseid_cli.report.comparison import score_table
from noiseid_cli.report.noise_units import noise_units_table
from noiseid_cli.report.parameter_recovery import parameter_recovery
from noiseid_cli.report.published import published_tables
from noiseid_cli.report.recovery import recovery_table
from noiseid_cli.report.side_by_side import compared, side_by_side
from noiseid_cli.report.study import Study
from noiseid_cli.report.sweep import sweep_table
from noiseid_cli.report.tables import Table
from noiseid_cli.report.tracking import hold_table, tracking_table
from noiseid_cli.report.unknown_parameters import parameter_estimates


def terminal_tables(study: Study) -> list[Table]:
    """How the units ended, before and after, the standard deviations, the agreement of several starts.

    Of a sweep, means per method and a row for each point. R is shown where it was estimated, the innovations per output
    where no truth is known to compare with, and published figures beside ours. Many units are summed up method by
    method.
    """
    if not study.results:
        return []
    many = len(study.results) > MANY
    if study.sweep:
        return [summary_table(study), sweep_table(study)]
    if many:
        tables = [summary_table(study), score_table(study), recovery_table(study), std_summary_table(study, "Q")]
    else:
        tables = [
            _without_last(ending_table(study)),
            before_after_table(study),
            _std(study, "Q"),
            noise_units_table(study),
        ]
    if any(not np.array_equal(r.estimate.start.R, r.estimate.final.R) for r in study.results):
        tables.append(std_summary_table(study, "R") if many else _std(study, "R"))
    if not many and all(r.Q_true is None for r in study.results):
        tables.append(consistency_table(study))
    together = side_by_side(study)
    alone = (
        parameter_estimates(study) if not many and (not together or len(compared(study)) < len(study.results)) else None
    )
    tables += [together, alone, parameter_recovery(study)]
    tables += [tracking_table(study), hold_table(study)]
    tables += [starts_table(study)] if start_groups(study) else []
    return [table for table in (*tables, *published_tables(study)) if table is not None]


def _std(study: Study, which: Literal["Q", "R"]) -> Table:
    """The standard deviations, without their kind where all were estimated."""
    table = std_table(study, which)
    return _without_last(table) if all(row[-1] == "estimated" for row in table.rows) else table


def _without_last(table: Table) -> Table:
    """A table without its last column, which a terminal has no room for."""
    return replace(table, columns=table.columns[:-1], rows=tuple(row[:-1] for row in table.rows))

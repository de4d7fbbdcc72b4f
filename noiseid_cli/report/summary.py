"""The few tables that a terminal shows at the end of a run."""

from __future__ import annotations

from dataclasses import replace

from noiseid_cli.report.agreement import consistency_table, start_groups, starts_table
from noiseid_cli.report.answer import kinds
from noiseid_cli.report.before_after import before_after_table
from noiseid_cli.report.build import (
    MANY,
    ending_table,
    std_summary_table,
    std_table,
    summary_table,
)
from noiseid_cli.report.comparison import score_table
from noiseid_cli.report.noise_units import noise_units_table
from noiseid_cli.report.parameter_recovery import parameter_recovery
from noiseid_cli.report.published import published_tables
from noiseid_cli.report.recovery import correlation_recovery_table, recovery_table
from noiseid_cli.report.shown import lean, with_short_names
from noiseid_cli.report.side_by_side import compared, side_by_side
from noiseid_cli.report.study import Study
from noiseid_cli.report.sweep import sweep_table
from noiseid_cli.report.tables import Table
from noiseid_cli.report.tracking import hold_table, tracking_table
from noiseid_cli.report.unknown_parameters import parameter_estimates


def terminal_tables(study: Study) -> list[Table]:
    """How the units ended, before and after, the standard deviations, the agreement of several starts.

    Of a sweep, means per method and a row for each point. Q and R are shown where they were estimated, the innovations
    per output where no truth is known to compare with, and published figures beside ours. Many units are summed up
    method by method.
    """
    if not study.results:
        return []
    study = with_short_names(study)
    return [lean(table, study) for table in _tables(study) if table is not None]


def _tables(study: Study) -> list[Table | None]:
    many = len(study.results) > MANY
    if study.sweep:
        return [summary_table(study), sweep_table(study)]
    estimated = "estimated" in kinds(study, "Q")
    tables: list[Table | None]
    if many:
        tables = [summary_table(study), score_table(study), recovery_table(study), correlation_recovery_table(study)]
        tables += [std_summary_table(study, "Q")] if estimated else []
    else:
        tables = [_without_last(ending_table(study)), before_after_table(study)]
        tables += [std_table(study, "Q"), noise_units_table(study)] if estimated else []
    if "estimated" in kinds(study, "R"):
        tables.append(std_summary_table(study, "R") if many else std_table(study, "R"))
    if not many and all(r.Q_true is None for r in study.results):
        tables.append(consistency_table(study))
    together = side_by_side(study)
    alone = (
        parameter_estimates(study) if not many and (not together or len(compared(study)) < len(study.results)) else None
    )
    tables += [together, alone, parameter_recovery(study)]
    tables += [tracking_table(study), hold_table(study)]
    tables += [starts_table(study)] if start_groups(study) else []
    return [*tables, *published_tables(study)]


def _without_last(table: Table) -> Table:
    """A table without its last column, which a terminal has no room for."""
    return replace(table, columns=table.columns[:-1], rows=tuple(row[:-1] for row in table.rows))

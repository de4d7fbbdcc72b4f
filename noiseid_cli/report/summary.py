"""The few tables that a terminal shows at the end of a run."""

from __future__ import annotations

from noiseid_cli.report.agreement import start_groups, starts_table
from noiseid_cli.report.build import MANY, before_after_table, std_summary_table, std_table, summary_table
from noiseid_cli.report.study import Study
from noiseid_cli.report.tables import Table


def terminal_tables(study: Study) -> list[Table]:
    """Before and after, the standard deviations, and the agreement of the starts where there are several."""
    if not study.results:
        return []
    many = len(study.results) > MANY
    tables = [summary_table(study)] if many else []
    tables.append(before_after_table(study))
    tables.append(std_summary_table(study, "Q") if many else std_table(study, "Q"))
    return [*tables, starts_table(study)] if start_groups(study) else tables

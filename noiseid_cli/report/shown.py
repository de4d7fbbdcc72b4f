"""What readers see of a study: units by what tells them apart, and no column that says the same in each row."""

from __future__ import annotations

from dataclasses import replace

from noiseid_cli.outcome import UnitResult
from noiseid_cli.report.study import Study
from noiseid_cli.report.tables import Cell, Column, Missing, Table


def with_short_names(study: Study) -> Study:
    """The same study with units named by method, dataset and start as far as those differ; all else as it was.

    ``results.csv`` keeps the names of the files; these are for tables that are read.
    """
    short = _short_names(study.results)
    if len(set(short)) < len(study.results):  # names that do not tell units apart would be worse than long ones
        return study
    new = dict(zip((r.unit for r in study.results), short, strict=True))
    results = [replace(r, unit=new[r.unit]) for r in study.results]
    sweep = study.sweep
    if sweep is not None:
        sweep = replace(sweep, values={new.get(unit, unit): values for unit, values in sweep.values.items()})
    return replace(study, results=results, sweep=sweep)


def _short_names(results: list[UnitResult]) -> list[str]:
    datasets = len({r.dataset for r in results}) > 1
    replicates = len({(r.dataset, r.replicate) for r in results}) > len({r.dataset for r in results})
    starts = len({r.start_index for r in results}) > 1
    names = []
    for r in results:
        parts = [r.dataset] if datasets else []
        parts += [f"replicate-{r.replicate:03d}"] if replicates else []
        parts += [r.method_label]
        parts += [f"start-{r.start_index}"] if starts else []
        names.append("/".join(parts))
    return names


def lean(table: Table, study: Study) -> Table:
    """The table without columns that say nothing: the name of what there is only one of, one kind, no value at all."""
    width = len(table.columns)
    gone = {j for j in range(width) if _needless(table, study, j)}
    if not gone or len(gone) == width:
        return table
    kept = [j for j in range(width) if j not in gone]
    rows: tuple[tuple[Cell, ...], ...] = tuple(tuple(row[j] for j in kept) for row in table.rows)
    keys = max(1, table.keys - sum(j < table.keys for j in gone))
    caption = " ".join(filter(None, [table.caption, *(_absent(table, j) for j in sorted(gone))]))
    return replace(table, columns=tuple(table.columns[j] for j in kept), rows=rows, keys=keys, caption=caption)


def _absent(table: Table, j: int) -> str:
    """Why a column of nothing but missing cells is left out; the reason is all that it says."""
    only = table.rows[0][j]
    return (
        f"{table.columns[j].heading}: {only.reason[:1].lower()}{only.reason[1:]}." if isinstance(only, Missing) else ""
    )


def _needless(table: Table, study: Study, j: int) -> bool:
    if not table.rows or len({row[j] for row in table.rows}) > 1:
        return False
    if j >= table.keys and (isinstance(table.rows[0][j], Missing) or table.rows[0][j] in ("", "–")):
        return True
    heading, only = table.columns[j].heading, table.rows[0][j]
    if heading == "Unit":
        return len(study.results) == 1
    if heading in ("Dataset", "Replicate"):
        return j > 0
    return table.columns[j] == KIND and only == "estimated"


KIND = Column("Kind")
"""What became of a figure: estimated, held or unchanged."""

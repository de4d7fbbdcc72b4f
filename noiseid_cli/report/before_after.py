"""The filter before and after: with the noise values of the start, of the estimate, and with those that were given."""

from __future__ import annotations

from collections.abc import Callable

from noiseid_cli.outcome import UnitResult
from noiseid_cli.report.reading import ALL_PLACES, At, evaluation, group, loglik, reason
from noiseid_cli.report.study import Study
from noiseid_cli.report.tables import Cell, Column, Table, number


def before_after_table(study: Study) -> Table:
    """Log-likelihood, mean NIS and path error of the filter at the start, at the estimate and at the truth."""
    path = any(has_path(r) for r in study.results)
    shown = [at for at in ALL_PLACES if at in ("start", "estimate") or any(at in r.evaluations for r in study.results)]
    columns = [Column("Unit"), Column("Filter at"), Column("Log-likelihood", decimals=2), Column("NIS")]
    readers: list[Callable[[UnitResult, At], float]] = [loglik, nis]
    held = any(r.held_out for r in study.results)
    if held:
        columns += [Column("Log-likelihood, held out", decimals=2), Column("NIS, held out")]
        readers += [_held_out_loglik, _held_out_nis]
    if path:
        columns.append(Column("Path error", study.path_unit()))
        readers.append(path_error)
    rows: list[tuple[Cell, ...]] = []
    several = len({(r.dataset, r.replicate) for r in study.results}) > 1
    for units in group(study.results, lambda r: (r.dataset, r.replicate)).values():
        lines = [(r, at, tuple(number(read(r, at), reason(r, at)) for read in readers)) for r in units for at in shown]
        given = {at: {cells for _, place, cells in lines if place == at} for at in ("tuning", "truth")}
        # What does not depend on the unit needs one row for all of them: today's tuning above, the truth below.
        shared = {at: cells.pop() for at, cells in given.items() if len(cells) == 1}
        name = units[0].unit if len(units) == 1 else f"all of {units[0].dataset}" if several else "all"
        rows += [(name, at, *cells) for at, cells in shared.items() if at == "tuning"]
        rows += [(r.unit, at, *cells) for r, at, cells in lines if at not in shared]
        rows += [(name, at, *cells) for at, cells in shared.items() if at == "truth"]
    caption = (
        "The same filter with different noise values. A higher log-likelihood is better; NIS is the mean "
        "normalised innovation squared per measurement, 1 for a consistent filter."
    )
    if "tuning" in shown:
        caption += " Tuning: the covariances in use today, as the experiment gives them."
    if held:
        caption += " Held out: data that no method has seen."
    if path:
        caption += " The path error is the 2-norm over time of the distance to the true path."
    return Table("before-after", "The filter before and after", caption, tuple(columns), tuple(rows), keys=2)


def nis(result: UnitResult, at: At) -> float:
    """Mean NIS at one place; NaN where the filter was not run."""
    found = evaluation(result, at)
    return found.nis if found else float("nan")


def _held_out_loglik(result: UnitResult, at: At) -> float:
    found = result.held_out.get(at)
    return found.loglik if found else float("nan")


def _held_out_nis(result: UnitResult, at: At) -> float:
    found = result.held_out.get(at)
    return found.nis if found else float("nan")


def has_path(result: UnitResult) -> bool:
    """Whether there is a true path to be away from."""
    return any(e.path_error is not None for e in result.evaluations.values())


def path_error(result: UnitResult, at: At) -> float:
    """2-norm over time of the path error at one place; NaN where there is none."""
    found = evaluation(result, at)
    return found.path_error_norm if found else float("nan")

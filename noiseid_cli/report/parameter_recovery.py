"""Estimated scalars over replicates: bias, spread, and whether the reported errors are those that occur."""

from __future__ import annotations

import math

import numpy as np

from noiseid_cli.models.recording import Array
from noiseid_cli.outcome import UnitResult
from noiseid_cli.report.over_time import over_time
from noiseid_cli.report.reading import converged, group
from noiseid_cli.report.recovery import Recovery
from noiseid_cli.report.study import Study
from noiseid_cli.report.tables import Cell, Column, Table, number

FEWEST = 3
"""With fewer replicates a spread says nothing."""


def parameter_recovery(study: Study) -> Table | None:
    """Mean, spread and coverage of each scalar unknown over replicates; None without replicates or truth."""
    rows: list[tuple[Cell, ...]] = []
    for label, firsts in _firsts(study).items():
        rows += [(label, *_row(firsts, i)) for i in range(len(_names(firsts[0])))]
    if not rows:
        return None
    columns = (
        Column("Method"), Column("Unknown"), Column("In"), Column("Truth", digits=3), Column("Mean", digits=3),
        Column("± Monte Carlo", digits=2), Column("Spread", digits=3), Column("Mean standard error", digits=3),
        Column("Within 1 se", "%"), Column("Within 1.96 se", "%"), Column("In 95 % interval", "%"),
        Column("Replicates"),
    )  # fmt: skip
    caption = (
        "Spread: standard deviation over the replicates; it should equal the mean of the standard errors that are "
        "reported. Of intervals, 68.3, 95 and 95 % should hold the truth; behind each share its Monte Carlo error. "
        "Intervals of what cannot be negative are taken on the logarithm."
    )
    title = "Estimates and reported errors over replicates"
    return Table("parameter-recovery", title, caption, columns, tuple(rows), keys=2)


def parameter_recoveries(study: Study) -> list[Recovery]:
    """Each scalar unknown of each method over replicates; none without replicates or truth, and for a sweep."""
    out = []
    for label, units in _firsts(study).items():
        for i, (name, unit, _) in enumerate(_names(units[0])):
            values, errors, truths, inside = _told(units, i)
            known = np.isfinite(errors)
            held = np.where(known, inside, math.nan)
            out.append(Recovery(label, "parameter", name, unit, float(truths[0]), values, errors, held, 0.95, math.nan))
    return out


def _firsts(study: Study) -> dict[str, list[UnitResult]]:
    """By method label, the first start of each replicate, where there are enough of them."""
    if study.sweep:
        return {}
    used = [r for r in study.results if converged(r) and r.estimate.parameters is not None and not over_time(r)]
    used = [r for r in used if r.parameters_true is not None]
    found = {
        label: [same[0] for same in group(units, lambda r: r.replicate).values()]
        for label, units in group(used, lambda r: r.method_label).items()
    }
    return {label: firsts for label, firsts in found.items() if len(firsts) >= FEWEST}


def _names(result: UnitResult) -> tuple[tuple[str, str, str], ...]:
    assert result.estimate.parameters is not None
    return result.estimate.parameters.names


def _row(units: list[UnitResult], i: int) -> tuple[Cell, ...]:
    name, unit, _ = _names(units[0])[i]
    values, errors, truths, inside = _told(units, i)
    n, spread = len(units), float(np.std(values, ddof=1))
    off = np.abs(values - truths) / errors
    known = bool(np.all(np.isfinite(off)))
    return (
        name, unit or "1", number(float(truths[0]), "The truth is not known"), float(values.mean()),
        spread / math.sqrt(n), spread, number(float(errors.mean()), "The method gives no standard error"),
        _share(off <= 1.0, known), _share(off <= 1.959963984540054, known), _share(inside, known), n,
    )  # fmt: skip


def _told(units: list[UnitResult], i: int) -> tuple[Array, Array, Array, np.ndarray]:
    """(n,) estimates, reported standard errors, truths, and whether the interval of 95 % holds the truth."""
    found = [r.estimate.parameters for r in units]
    values = np.array([p.final[i] for p in found if p is not None])
    errors = np.array([math.nan if p is None or p.standard_errors is None else p.standard_errors[i] for p in found])
    truths = np.array([math.nan if r.parameters_true is None else r.parameters_true[i] for r in units])
    intervals = np.array([p.interval(i) for p in found if p is not None])
    return values, errors, truths, (intervals[:, 0] <= truths) & (truths <= intervals[:, 1])


def _share(inside: Array | np.ndarray, known: bool) -> Cell:
    """Share in per cent with its Monte Carlo error."""
    if not known:
        return "–"
    p, n = float(np.mean(inside)), len(inside)
    return f"{100 * p:.1f} ± {100 * math.sqrt(p * (1 - p) / n):.1f}"

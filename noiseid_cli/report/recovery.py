"""Estimated noise values over replicates: bias, spread, reported errors, coverage, and the spread against the bound."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from noiseid_cli.models.recording import Array
from noiseid_cli.outcome import UnitResult
from noiseid_cli.report.reading import converged, correlation, covariances, group, remark, std
from noiseid_cli.report.study import Study
from noiseid_cli.report.tables import Cell, Column, Missing, Table, number

Letter = Literal["Q", "R"]
KINDS: tuple[tuple[Letter, str], ...] = (("Q", "process_noise"), ("R", "measurement_noise"))
FEW = "Fewer than two replicates converged"


@dataclass(frozen=True)
class Recovery:
    """One figure of one method over n replicates; several starts of a replicate, which share its data, are averaged.

    Attributes:
        method, metric, index, unit: which figure, as in the tidy table.
        truth: its true value.
        values: (n,) estimates.
        errors: (n,) reported standard errors; NaN where there is none.
        inside: (n,) whether the reported interval holds the truth; NaN where there is none.
        level: confidence level of the intervals.
        bound: the least standard error of an unbiased estimate; NaN where it is not known.
    """

    method: str
    metric: str
    index: str
    unit: str
    truth: float
    values: Array
    errors: Array
    inside: Array
    level: float
    bound: float

    @property
    def spread(self) -> float:
        """Standard deviation of one estimate; NaN for fewer than two."""
        return float(np.std(self.values, ddof=1)) if len(self.values) > 1 else math.nan

    def share_inside(self) -> tuple[float, float]:
        """Share of the intervals that hold the truth, and the Monte Carlo error it has if they keep their level."""
        known = self.inside[np.isfinite(self.inside)]
        if not known.size:
            return math.nan, math.nan
        return float(known.mean()), math.sqrt(self.level * (1.0 - self.level) / known.size)


def recoveries(study: Study) -> list[Recovery]:
    """Every noise value that was estimated, of every method, over the replicates that converged.

    None without replicates or truth, and for a sweep, whose points may have truths of their own.
    """
    if study.sweep or len({r.replicate for r in study.results}) < 2 or all(r.Q_true is None for r in study.results):
        return []
    out = []
    for units in group([r for r in study.results if converged(r)], lambda r: r.method_label).values():
        replicates = list(group(units, lambda r: r.replicate).values())
        out += [_recovery(study, replicates, *figure) for figure in _figures(units)]
    return out


def _figures(units: Sequence[UnitResult]) -> list[tuple[int, int, int]]:
    """(0 for Q and 1 for R, row, column) of each standard deviation and correlation that was estimated.

    The estimate of one unit tells which correlations are zero by structure, or held.
    """
    out = []
    for which, (letter, _) in enumerate(KINDS):
        final = covariances(units[0], "estimate")[which]
        truth = covariances(units[0], "truth")[which]
        if final is None or truth is None:
            continue
        shown = [i for i in range(len(final)) if any(remark(u, letter, i) == "estimated" for u in units)]
        out += [(which, i, i) for i in shown]
        start = getattr(units[0].estimate.start, letter)
        free = [(i, j) for i in shown for j in range(i) if final[i, j] not in (0.0, start[i, j])]
        out += [(which, i, j) for i, j in free if truth[i, i] * truth[j, j] > 0.0]
    return out


def _recovery(study: Study, replicates: Sequence[list[UnitResult]], which: int, i: int, j: int) -> Recovery:
    first = replicates[0][0]
    names = first.noise_names if which == 0 else first.output_names
    metric = f"{KINDS[which][1]}_{'std' if i == j else 'correlation'}"
    index = names[i][0] if i == j else f"{names[i][0]}, {names[j][0]}"
    truth = _value(covariances(first, "truth")[which], i, j)
    values = [float(np.mean([_value(covariances(u, "estimate")[which], i, j) for u in same])) for same in replicates]
    told = np.array([np.mean([_told(u, metric, index, truth) for u in same], axis=0) for same in replicates])
    levels = [u.uncertainty.level for same in replicates for u in same if u.uncertainty is not None]
    return Recovery(
        method=first.method_label,
        metric=metric,
        index=index,
        unit=names[i][1] if i == j else "",
        truth=truth,
        values=np.array(values),
        errors=told[:, 0],
        inside=told[:, 1],
        level=levels[0] if levels else math.nan,
        bound=study.bounds.get(first.method_label, {}).get((metric, index), math.nan),
    )


def _value(covariance: Array | None, i: int, j: int) -> float:
    if i == j or covariance is None:
        return std(covariance, i)
    return float(correlation(covariance)[i, j])


def _told(unit: UnitResult, metric: str, index: str, truth: float) -> tuple[float, float]:
    """Reported standard error, and 1 if the interval holds the truth; NaN where there is none."""
    found = unit.uncertainty
    k = None if found is None else found.index(metric, index)
    if found is None or k is None:
        return math.nan, math.nan
    return float(found.standard_errors[k]), float(found.lower[k] <= truth <= found.upper[k])


def recovery_table(study: Study) -> Table | None:
    """Bias, spread, reported error and coverage of each standard deviation; the spread against the bound."""
    found = [r for r in recoveries(study) if r.metric.endswith("_std")]
    if not found:
        return None
    both = len({r.metric for r in found}) > 1
    title = f"Bias, spread and reported errors of the standard deviations{'' if both else ' of the process noise'}"
    caption = "Relative to the truth, over independent noise realisations."
    return _table("recovery", title, caption, found, relative=True)


def correlation_recovery_table(study: Study) -> Table | None:
    """The same of the correlations, as they are."""
    found = [r for r in recoveries(study) if r.metric.endswith("_correlation")]
    if not found:
        return None
    caption = "Over independent noise realisations."
    title = "Bias, spread and reported errors of the correlations"
    return _table("recovery-correlations", title, caption, found, relative=False)


def _table(name: str, title: str, caption: str, found: Sequence[Recovery], relative: bool) -> Table:
    unit, decimals = ("%", 2) if relative else ("", 4)
    columns = [Column("Method"), Column("Noise"), Column("Truth"), *([Column("In")] if relative else [])]
    columns += [Column("Replicates"), Column("Bias", unit, decimals=decimals)]
    columns += [Column("± Monte Carlo", unit, decimals=decimals), Column("Spread", unit, decimals=decimals)]
    caption += (
        " Spread: standard deviation of one estimate. A bias beyond two or three times its Monte Carlo error is one."
    )
    told = any(np.isfinite(r.errors).any() for r in found)
    bounded = any(math.isfinite(r.bound) for r in found)
    if told:
        level = next(r.level for r in found if math.isfinite(r.level))
        columns += [Column("Reported error", unit, decimals=decimals), Column("Reported / spread", decimals=3)]
        columns += [Column(f"In {100 * level:g} % interval", "%")]
        caption += (
            " Reported error: mean of the standard errors that the units report; it should equal the spread. Of the "
            f"{100 * level:g} % intervals so many hold the truth; behind ± the Monte Carlo error of the share."
        )
    if bounded:
        columns += [Column("Bound", unit, decimals=decimals), Column("Spread / bound", decimals=3)]
        caption += " Bound: the least spread of an unbiased estimate (Cramér-Rao), exact for this linear model."
    if told or bounded:
        n = max(len(r.values) for r in found)
        error = 100 / math.sqrt(2 * max(n - 1, 1))
        caption += f" Of {n} replicates a spread, and a ratio with it, has a Monte Carlo error of {error:.2g} %."
    rows = tuple(_row(r, relative, told, bounded) for r in found)
    return Table(name, title, caption, tuple(columns), rows, keys=2)


def _row(r: Recovery, relative: bool, told: bool, bounded: bool) -> tuple[Cell, ...]:
    scale = 100.0 / r.truth if relative and r.truth > 0.0 else math.nan if relative else 1.0
    n, bias, spread = len(r.values), scale * (float(r.values.mean()) - r.truth), scale * r.spread
    cells: list[Cell] = [r.method, r.index, number(r.truth, "Not known"), *([r.unit or "1"] if relative else []), n]
    cells += [number(bias, FEW), number(spread / math.sqrt(n), FEW), number(spread, FEW)]
    if told:
        known = r.errors[np.isfinite(r.errors)]
        error = scale * float(known.mean()) if known.size else math.nan
        none = "The method reports no standard error of it"
        cells += [number(error, none), number(error / spread, none), share(*r.share_inside(), none)]
    if bounded:
        none = "There is no exact bound for what this method estimates"
        bound = scale * r.bound
        cells += [number(bound, none), number(spread / bound, FEW if math.isfinite(bound) else none)]
    return tuple(cells)


def share(value: float, error: float, why_not: str) -> Cell:
    """A share in per cent with its Monte Carlo error, as text."""
    return f"{100 * value:.1f} ± {100 * error:.1f}" if math.isfinite(value) else Missing(why_not)

"""Statistical claims over several experiments in two tables: one row per method, and one row per figure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from noiseid_cli.report.parameter_recovery import parameter_recoveries
from noiseid_cli.report.recovery import Recovery, recoveries, share
from noiseid_cli.report.study import Study
from noiseid_cli.report.tables import Cell, Column, Missing, Table

NO_BOUND = "Exact for linear models with known parameters"
NO_ERROR = "The method reports no standard error"


@dataclass(frozen=True)
class Validated:
    """All figures of one method in one experiment.

    Attributes:
        experiment, method: which.
        units: number of units, converged or not.
        figures: what was estimated, over the replicates that converged.
    """

    experiment: str
    method: str
    units: int
    figures: tuple[Recovery, ...]

    @property
    def replicates(self) -> int:
        """How many replicates converged."""
        return max(len(r.values) for r in self.figures)


def validated(study: Study) -> list[Validated]:
    """The methods of a study over replicates, with noise values and scalar unknowns."""
    found = [*recoveries(study), *parameter_recoveries(study)]
    by_method = {m: tuple(r for r in found if r.method == m) for m in dict.fromkeys(r.method for r in found)}
    counts = {m: sum(u.method_label == m for u in study.results) for m in by_method}
    return [Validated(study.experiment, m, counts[m], figures) for m, figures in by_method.items()]


def validation_table(found: Sequence[Validated]) -> Table:
    """One row per method and experiment: the worst bias, and errors, coverage and efficiency over its figures."""
    columns = (
        Column("Experiment"), Column("Method"), Column("Replicates"), Column("Figures"), Column("Worst bias"),
        Column("Reported error / spread"), Column("In 95 % interval", "%"), Column("Spread / bound"),
    )  # fmt: skip
    rows = tuple((v.experiment, v.method, v.replicates, len(v.figures), _worst(v), *_over_figures(v)) for v in found)
    caption = (
        "Over independent noise realisations; behind ± stands the Monte Carlo error. Worst bias: of the figure whose "
        "bias is largest beside its Monte Carlo error; among many figures two or three times it is chance. Reported "
        "error / spread: least and greatest, over the figures, of the mean standard error that was reported over the "
        "standard deviation of the estimates; 1 is right. In 95 % interval: how many of all intervals hold the truth. "
        "Spread / bound: least and greatest ratio of the spread to the least one of an unbiased estimate (Cramér-Rao); "
        "1 is the best possible."
    )
    return Table("validation", "Estimates and reported errors against the truth", caption, columns, rows, keys=2)


def figures_table(found: Sequence[Validated]) -> Table:
    """One row per figure."""
    columns = (
        Column("Experiment"), Column("Method"), Column("Figure"), Column("Truth", digits=3), Column("In"),
        Column("Bias"), Column("Spread", digits=3), Column("Reported error", digits=3), Column("Reported / spread"),
        Column("In 95 % interval", "%"), Column("Spread / bound"),
    )  # fmt: skip
    rows = tuple((v.experiment, v.method, *_figure(r)) for v in found for r in v.figures)
    caption = "As above, figure by figure, each in its own unit."
    return Table("validation-figures", "Figure by figure", caption, columns, rows, keys=3)


def _name(r: Recovery) -> str:
    return f"{r.metric.rsplit('_', 1)[-1]} {r.index}" if r.metric != "parameter" else r.index


def _bias(r: Recovery) -> tuple[float, float]:
    """Bias and its Monte Carlo error."""
    return float(r.values.mean()) - r.truth, r.spread / math.sqrt(len(r.values))


def _worst(v: Validated) -> Cell:
    """Bias of the figure that is furthest off, in per cent of the truth; a correlation as it is."""
    r = max(v.figures, key=lambda r: abs(_bias(r)[0]) / _bias(r)[1] if _bias(r)[1] > 0.0 else 0.0)
    bias, error = _bias(r)
    if r.metric.endswith("_correlation") or r.truth == 0.0:
        return f"{bias:+.4f} ± {error:.4f}, {_name(r)}"
    return f"{100 * bias / r.truth:+.2f} ± {100 * error / abs(r.truth):.2f} %, {_name(r)}"


def _over_figures(v: Validated) -> tuple[Cell, Cell, Cell]:
    errors = [ratio for r in v.figures if math.isfinite(ratio := _reported(r) / r.spread)]
    efficiency = [ratio for r in v.figures if math.isfinite(ratio := r.spread / r.bound)]
    n = v.replicates
    return _range(errors, n, NO_ERROR), _pooled(v), _range(efficiency, n, NO_BOUND)


def _pooled(v: Validated) -> Cell:
    """Share of all intervals, with its scatter from replicate to replicate: figures of one replicate hang together."""
    inside = np.array([r.inside for r in v.figures if np.isfinite(r.inside).all()])
    if not inside.size:
        return Missing(NO_ERROR)
    per_replicate = inside.mean(axis=0)
    n = len(per_replicate)
    return share(float(per_replicate.mean()), float(per_replicate.std(ddof=1)) / math.sqrt(n), NO_ERROR)


def _range(ratios: Sequence[float], n: int, why_not: str) -> Cell:
    """Least and greatest ratio with a spread, whose Monte Carlo error is that of a normal estimate."""
    if not ratios:
        return Missing(why_not)
    low, high = f"{min(ratios):.3f}", f"{max(ratios):.3f}"
    return f"{low if low == high else f'{low} to {high}'} ± {1 / math.sqrt(2 * (n - 1)):.3f}"


def _reported(r: Recovery) -> float:
    known = r.errors[np.isfinite(r.errors)]
    return float(known.mean()) if known.size else math.nan


def _figure(r: Recovery) -> tuple[Cell, ...]:
    n, (bias, error), reported = len(r.values), _bias(r), _reported(r)
    ratio = 1 / math.sqrt(2 * (n - 1))
    told: tuple[Cell, ...] = (Missing(NO_ERROR),) * 3
    if math.isfinite(reported):
        told = (reported, f"{reported / r.spread:.3f} ± {ratio:.3f}", share(*r.share_inside(), NO_ERROR))
    bound: Cell = f"{r.spread / r.bound:.3f} ± {ratio:.3f}" if math.isfinite(r.bound) else Missing(NO_BOUND)
    return _name(r), r.truth, r.unit or "1", f"{bias:+.2g} ± {error:.2g}", r.spread, *told, bound

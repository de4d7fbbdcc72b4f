"""A sweep in one table and a figure for each axis: what was found at each value of what was varied."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from noiseid_cli.outcome import UnitResult
from noiseid_cli.report.figure_style import (
    INK,
    Plot,
    legend_above,
    log_axis,
    method_colours,
    panels,
    plot_text,
)
from noiseid_cli.report.reading import converged, covariances, group, remark, std
from noiseid_cli.report.study import Study
from noiseid_cli.report.tables import Cell, Column, Missing, Table, number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHOWN = 200
"""The table holds at most so many rows; results.csv holds all."""

MAX_PANELS = 8
_LOGARITHMIC = 20.0
"""An axis whose values span more than this factor is drawn in logarithms."""

Quantity = tuple[str, str, float, float]
"""Name, unit, estimate and truth (NaN where not known)."""


def quantities(result: UnitResult) -> list[Quantity]:
    """The standard deviations and parameters that were estimated."""
    out: list[Quantity] = []
    Q, R = covariances(result, "estimate")
    Q_true, R_true = covariances(result, "truth")
    for i, (name, unit, _) in enumerate(result.noise_names):
        if remark(result, "Q", i) == "estimated":
            out.append((name, unit, std(Q, i), std(Q_true, i)))
    for i, (name, unit, _) in enumerate(result.output_names):
        if remark(result, "R", i) == "estimated":
            out.append((f"{name} (measured)", unit, std(R, i), std(R_true, i)))
    found = result.estimate.parameters
    if found is not None:
        truth = result.parameters_true
        for i, (name, unit, _) in enumerate(found.names):
            out.append((name, unit, float(found.final[i]), math.nan if truth is None else float(truth[i])))
    return out


def sweep_table(study: Study) -> Table:
    """Per method, point and estimated quantity: mean, spread and, where known, the mean ratio to the truth."""
    assert study.sweep is not None
    sweep = study.sweep
    columns = [Column("Method"), *(Column(axis) for axis in sweep.axes), Column("Of"), Column("In")]
    columns += [Column("Converged / all"), Column("Mean"), Column("Spread"), Column("Ratio to truth")]
    rows: list[tuple[Cell, ...]] = []
    total = 0
    for (method, values), units in group(study.results, lambda r: (r.method_label, sweep.values[r.unit])).items():
        used = [u for u in units if converged(u)]
        count = f"{len(used)} / {len(units)}"
        found = group_quantities(used)
        for (name, unit), pairs in found.items():
            total += 1
            if len(rows) < SHOWN:
                rows.append((method, *values, name, unit or "1", count, *_figures(pairs)))
        if not found:
            total += 1
            why = Missing("No unit converged" if not used else "Nothing was estimated")
            if len(rows) < SHOWN:
                rows.append((method, *values, "–", "–", count, why, why, why))
    caption = (
        "Standard deviations, per sample, and parameters. Mean and standard deviation over the units of the point "
        "that converged: its replicates and starts. Ratio to truth: mean of estimate / truth."
    )
    if total > len(rows):
        caption += f" The first {len(rows)} of {total} rows; all units are in results.csv."
    keys = 1 + len(sweep.axes)
    return Table("sweep", "What was found at each point", caption, tuple(columns), tuple(rows), keys=keys)


def group_quantities(units: list[UnitResult]) -> dict[tuple[str, str], list[tuple[float, float]]]:
    """Estimate and truth of each quantity over units."""
    out: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for result in units:
        for name, unit, estimate, truth in quantities(result):
            out.setdefault((name, unit), []).append((estimate, truth))
    return out


def _figures(pairs: list[tuple[float, float]]) -> tuple[Cell, Cell, Cell]:
    ends = [estimate for estimate, _ in pairs]
    ratios = [estimate / truth for estimate, truth in pairs if truth and math.isfinite(truth)]
    spread = float(np.std(ends, ddof=1)) if len(ends) > 1 else None
    return (
        number(float(np.mean(ends)), "Not available for every unit that converged"),
        number(spread, "Fewer than two units converged"),
        number(float(np.mean(ratios)) if ratios else None, "The truth is zero or not known"),
    )


def sweep_plots(study: Study) -> list[Plot]:
    """Per axis with several values, the estimates over it."""
    assert study.sweep is not None
    plots = []
    good = [r for r in study.results if converged(r) and quantities(r)]
    for k, axis in enumerate(study.sweep.axes):
        if len({study.sweep.values[r.unit][k] for r in good}) < 2:
            continue
        relative = all(t and math.isfinite(t) for r in good for _, _, _, t in quantities(r))
        what = "Estimate over truth" if relative else "Estimate"
        others = len(study.sweep.axes) > 1
        caption = (
            f"{what} of each unit that converged, over {axis} ({study.sweep.settings[k]}); "
            "the line joins the medians of each value."
            + (" Units with all values of the other axes are drawn." if others else "")
        )
        plots.append(
            Plot(f"sweep-{k + 1}", f"Estimates over {axis}", caption, partial(_draw, study, k, good, relative))
        )
    return plots


def _draw(study: Study, k: int, good: list[UnitResult], relative: bool) -> Figure:
    assert study.sweep is not None
    sweep = study.sweep
    names = list(dict.fromkeys((n, u) for r in good for n, u, _, _ in quantities(r)))[:MAX_PANELS]
    places, ticks = _places([sweep.values[r.unit][k] for r in good])
    colours = method_colours([r.method_label for r in study.results])
    figure, axes = panels(len(names), 2, 2.4)
    for axis, (name, unit) in zip(axes, names, strict=True):
        for method, units in group(good, lambda r: r.method_label).items():
            ends: dict[float, list[float]] = {}
            for r in units:
                for n, _, estimate, truth in quantities(r):
                    if n == name and math.isfinite(estimate):
                        at = places[sweep.values[r.unit][k]]
                        ends.setdefault(at, []).append(estimate / truth if relative else estimate)
            x = sorted(ends)
            axis.plot(
                [v for v in x for _ in ends[v]], [e for v in x for e in ends[v]],
                "o", color=colours[method], alpha=0.35, markersize=3.5, markeredgewidth=0,
            )  # fmt: skip
            axis.plot(x, [float(np.median(ends[v])) for v in x], color=colours[method], label=plot_text(method))
        _finish(axis, ticks, list(places.values()), relative)
        axis.set_title(plot_text(name if relative or not unit else f"{name} [{unit}]"))
        axis.set_xlabel(plot_text(sweep.axes[k]))
    axes[0].set_ylabel("Estimate / truth" if relative else "Estimate")
    legend_above(figure, axes[0])
    return figure


def _places(values: list[float | int | str]) -> tuple[dict[float | int | str, float], list[str]]:
    """Where each value lies on the axis: numbers at themselves, anything else one after the other under its text."""
    distinct = list(dict.fromkeys(values))
    if all(not isinstance(v, str) for v in distinct):
        return {v: float(v) for v in distinct}, []
    return {v: float(i) for i, v in enumerate(distinct)}, [plot_text(str(v)) for v in distinct]


def _finish(axis: Axes, ticks: list[str], places: list[float], relative: bool) -> None:
    if relative:
        axis.axhline(1.0, color=INK, linestyle=":", linewidth=1.0)
    if ticks:
        axis.set_xticks(range(len(ticks)), ticks)
    elif min(places) > 0 and max(places) > _LOGARITHMIC * min(places):
        log_axis(axis, "x")

"""Figures of the way to the estimate: log-likelihood and standard deviations over the passes."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from noiseid_cli.outcome import UnitResult
from noiseid_cli.report.figure_style import (
    BAND,
    INK,
    LINE_STYLES,
    LineStyle,
    Plot,
    legend_above,
    log_axis,
    method_colours,
    panels,
    plot_text,
)
from noiseid_cli.report.noise_units import unit_words
from noiseid_cli.report.reading import covariances, featured, group, loglik, remark, std
from noiseid_cli.report.study import Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Mask = NDArray[np.bool_]

LEGIBLE = 8
"""With more units than this, only the featured ones get curves of their own."""

MAX_PANELS = 8


def curves(study: Study) -> tuple[list[UnitResult], str]:
    """The units that get curves, and a sentence on those that do not."""
    if len(study.results) <= LEGIBLE:
        return list(study.results), ""
    shown = featured(study.results)
    note = f" {len(shown)} of {len(study.results)} units are drawn: the best start of each method and dataset."
    return shown, note


def unit_labels(shown: list[UnitResult], study: Study) -> list[str]:
    """Short labels: the method, and of start, dataset and replicate what differs in the study."""
    starts = {r.start_index for r in study.results}
    replicates = {r.replicate for r in study.results}
    datasets = {r.dataset for r in study.results}
    labels = []
    for r in shown:
        parts = [r.method_label]
        parts += [f"start {r.start_label}"] if len(starts) > 1 else []
        parts += [r.dataset] if len(datasets) > 1 else []
        parts += [f"replicate {r.replicate}"] if len(replicates) > 1 and len(datasets) == 1 else []
        labels.append(plot_text(", ".join(parts)))
    return labels


def unit_styles(shown: list[UnitResult], study: Study) -> list[tuple[str, LineStyle]]:
    """Colour by method; line style by order among the units of that method."""
    colours = method_colours([r.method_label for r in study.results])
    place: dict[str, int] = {}
    out: list[tuple[str, LineStyle]] = []
    for r in shown:
        n = place[r.method_label] = place.get(r.method_label, -1) + 1
        out.append((colours[r.method_label], LINE_STYLES[n % len(LINE_STYLES)]))
    return out


def accepted(result: UnitResult) -> tuple[Mask, Mask]:
    """(passes,) masks of the points that were kept and of those that were rejected, with a finite likelihood."""
    trace = result.estimate.trace
    finite = np.isfinite(trace["loglik"])
    kept = np.asarray(trace.get("accepted", np.ones(len(finite))), dtype=bool)
    return finite & kept, finite & ~kept


def convergence_plot(study: Study) -> Plot | None:
    """Log-likelihood over passes, and its distance to the best that any unit reached on the same data."""
    traced = [r for r in study.results if len(r.estimate.trace.get("loglik", ()))]
    shown, note = curves(study)
    shown = [r for r in shown if len(r.estimate.trace.get("loglik", ()))]
    if not shown:
        return None
    if len(traced) > LEGIBLE:
        note += " Shaded: from the nearest to the farthest of all units of a method."
    caption = (
        "Left: log-likelihood after each pass over the data. Right: its distance to the best that any unit reached "
        "on the same data; the best itself, at distance 0, cannot be drawn on this axis. Crosses are accelerated "
        "steps that were tried and rejected." + note + study.chosen()
    )
    draw = partial(_draw_convergence, study, shown, traced)
    return Plot("convergence", "Log-likelihood over the passes", caption, draw)


def _draw_convergence(study: Study, shown: list[UnitResult], traced: list[UnitResult]) -> Figure:
    best = _best_per_dataset(traced)
    figure, (left, right) = panels(2, 2, 2.9)
    for r, label, (colour, line) in zip(shown, unit_labels(shown, study), unit_styles(shown, study), strict=True):
        values = r.estimate.trace["loglik"]
        kept, rejected = accepted(r)
        passes = np.arange(1, len(values) + 1)
        distance = best[r.dataset, r.replicate] - values
        left.plot(passes[kept], values[kept], color=colour, linestyle=line, label=label)
        away = kept & (distance > 0)
        right.plot(passes[away], distance[away], color=colour, linestyle=line)
        right.plot(passes[rejected], distance[rejected], "x", color=colour, markersize=4, label="_")
    if len(traced) > LEGIBLE:
        _ranges(right, traced, best, study)
    if any(accepted(r)[1].any() for r in shown):
        left.plot([], [], "x", color=BAND, markersize=4, label="rejected acceleration")
    _dress_convergence(left, right, max(len(r.estimate.trace["loglik"]) for r in traced))
    legend_above(figure, left)
    return figure


def _best_per_dataset(traced: list[UnitResult]) -> dict[tuple[str, int], float]:
    best = {}
    for key, units in group(traced, lambda r: (r.dataset, r.replicate)).items():
        ends = [loglik(u, "estimate") for u in units]
        points = [float(u.estimate.trace["loglik"][accepted(u)[0]].max(initial=-np.inf)) for u in units]
        best[key] = max(v for v in [*ends, *points, -np.inf] if not np.isnan(v))
    return best


def _ranges(axis: Axes, traced: list[UnitResult], best: dict[tuple[str, int], float], study: Study) -> None:
    """Range of the distance over all units of each method; a unit that has ended stays at its last point."""
    colours = method_colours([r.method_label for r in study.results])
    for method, units in group(traced, lambda r: r.method_label).items():
        longest = max(len(u.estimate.trace["loglik"]) for u in units)
        rows = np.full((len(units), longest), np.nan)
        for row, u in zip(rows, units, strict=True):
            values = np.where(accepted(u)[0], u.estimate.trace["loglik"], -np.inf)
            reached = np.maximum.accumulate(values)
            row[: len(reached)] = best[u.dataset, u.replicate] - reached
            row[len(reached) :] = row[len(reached) - 1]
        rows[~(np.isfinite(rows) & (rows > 0))] = np.nan
        some = np.flatnonzero(np.isfinite(rows).any(axis=0))
        low, high = np.nanmin(rows[:, some], axis=0), np.nanmax(rows[:, some], axis=0)
        axis.fill_between(some + 1, low, high, color=colours[method], alpha=0.15, linewidth=0)


def _dress_convergence(left: Axes, right: Axes, passes: int) -> None:
    left.set_ylabel("Log-likelihood")
    right.set_ylabel("Distance to the best")
    if right.lines and any(len(np.asarray(line.get_xdata())) for line in right.lines):
        log_axis(right, "y")
    for axis in (left, right):
        _pass_axis(axis, passes)


def _pass_axis(axis: Axes, passes: int) -> None:
    """Passes on a logarithmic axis where they are many: the first ones change most."""
    from matplotlib.ticker import MaxNLocator

    axis.set_xlabel("Pass over the data")
    if passes > 100:
        log_axis(axis, "x")
    else:
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))


def std_plots(study: Study) -> list[Plot]:
    """Standard deviations over passes, of the process noise and, where estimated, of the measurement noise."""
    found = [_std_plot(study, "Q")]
    if any(remark(r, "R", i) == "estimated" for r in study.results for i in range(len(r.output_names))):
        found.append(_std_plot(study, "R"))
    return [plot for plot in found if plot]


def _std_plot(study: Study, which: Literal["Q", "R"]) -> Plot | None:
    shown, note = curves(study)
    shown = [r for r in shown if len(r.estimate.trace.get(which, ())) and "loglik" in r.estimate.trace]
    if not shown:
        return None
    count = len(shown[0].noise_names if which == "Q" else shown[0].output_names)
    kind = "process noise" if which == "Q" else "measurement noise"
    more = f" The first {MAX_PANELS} of {count} are drawn." if count > MAX_PANELS else ""
    words = unit_words(study) if which == "Q" else "per sample"
    caption = f"Standard deviation of each {kind}, {words}, after each pass." + more + note + study.chosen()
    title = f"Standard deviations of the {kind} over the passes"
    return Plot(f"std-{kind.replace(' ', '-')}", title, caption, partial(_draw_std, study, which, shown))


def _draw_std(study: Study, which: Literal["Q", "R"], shown: list[UnitResult]) -> Figure:
    names, letter = (shown[0].noise_names, "v") if which == "Q" else (shown[0].output_names, "e")
    figure, axes = panels(min(len(names), MAX_PANELS), 2, 1.9)
    looks = list(zip(shown, unit_labels(shown, study), unit_styles(shown, study), strict=True))
    for i, axis in enumerate(axes):
        for r, label, (colour, line) in looks:
            variance = r.estimate.trace[which][:, i, i]
            good = accepted(r)[0] & (variance > 0)
            passes = np.arange(1, len(good) + 1)[good]
            axis.plot(passes, np.sqrt(variance[good]), color=colour, linestyle=line, label=label)
        _truth_line(axis, shown, which, i)
        name, unit, _ = names[i]
        axis.set_title(plot_text(name), loc="left")
        axis.set_ylabel(f"std({letter}) [{plot_text(unit or '1')}]")
        log_axis(axis, "y")
        _pass_axis(axis, max(len(r.estimate.trace["loglik"]) for r in shown))
    for axis in axes[:-2]:
        axis.set_xlabel("")
    legend_above(figure, axes[0])
    return figure


def _truth_line(axis: Axes, shown: list[UnitResult], which: Literal["Q", "R"], i: int) -> None:
    truths = {std(covariances(r, "truth")[0 if which == "Q" else 1], i) for r in shown}
    for n, truth in enumerate(sorted(t for t in truths if t > 0)):
        axis.axhline(truth, color=INK, linestyle=":", linewidth=1.2, label="_" if n else "truth")

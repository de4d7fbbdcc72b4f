"""Methods side by side: path errors over starts, on the data and on held-out tests."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from noiseid_cli.outcome import UnitResult
from noiseid_cli.report.figure_style import INK, Plot, legend_above, method_colours, panels, plot_text
from noiseid_cli.report.figures_time import WINDOW_SHARE, path_error_curve
from noiseid_cli.report.reading import group
from noiseid_cli.report.study import Study
from noiseid_cli.report.tables import Cell, Column, Missing, Table, number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def path_norm(result: UnitResult, held_out: bool = False) -> float:
    """2-norm over time of the path error at the estimate; on held-out tests, the root mean square of it over tests."""
    found = (result.held_out if held_out else result.evaluations).get("estimate")
    if found is None:
        return math.nan
    return found.path_error_norm / math.sqrt(result.held_out_tests) if held_out else found.path_error_norm


def score_table(study: Study) -> Table | None:
    """Best and worst unit of each method in path error and NIS, on its own data and on held-out ones; no sweeps."""
    if study.sweep:
        return None
    held = any(r.held_out for r in study.results)
    known = [r for r in study.results if math.isfinite(path_norm(r)) or (held and math.isfinite(path_norm(r, True)))]
    if not known:
        return None
    unit = study.path_unit()
    columns = [Column("Method"), Column("Path error, max", unit), Column("min", unit)]
    columns += [Column("Max / min", digits=5), Column("NIS, mean", digits=4)]
    if held:
        columns += [Column("Held-out path error, max", unit), Column("min", unit), Column("Held-out NIS, mean")]
    rows = []
    for method, units in group(study.results, lambda r: r.method_label).items():
        ends = [path_norm(u) for u in units]
        cells: list[Cell] = [_extreme(max, ends), _extreme(min, ends), _ratio(ends), _mean_nis(units, held_out=False)]
        if held:
            scores = [path_norm(u, True) for u in units]
            cells += [_extreme(max, scores), _extreme(min, scores), _mean_nis(units, held_out=True)]
        rows.append((method, *cells))
    rows.append(_truth_row(study, held))
    caption = (
        "2-norm over time of the distance to the true path, largest and smallest over all starts and datasets of the "
        "method, whether converged or not. Truth: the same filter with the covariances that made the data."
    )
    if held:
        caption += " Held out: tests with noise and a path that no method has seen; root mean square over those tests."
    return Table("scores", "Path error of each method", caption, tuple(columns), tuple(rows))


def _truth_row(study: Study, held: bool) -> tuple[Cell, ...]:
    """The same figures for the true covariances, of which there is one per dataset."""
    units = [units[0] for units in group(study.results, lambda r: r.dataset).values()]
    found = [u.evaluations["truth"] for u in units if "truth" in u.evaluations]
    ends = [e.path_error_norm for e in found]
    nis = number(float(np.mean([e.nis for e in found])) if found else None, "The truth is not known")
    cells: list[Cell] = [_extreme(max, ends), _extreme(min, ends), _ratio(ends), nis]
    if held:
        out = [(u.held_out["truth"], u.held_out_tests) for u in units if "truth" in u.held_out]
        scores = [e.path_error_norm / math.sqrt(n) for e, n in out]
        mean = number(float(np.mean([e.nis for e, _ in out])) if out else None, "The truth is not known")
        cells += [_extreme(max, scores), _extreme(min, scores), mean]
    return ("truth", *cells)


def _extreme(which: Callable[[list[float]], float], values: list[float]) -> Cell:
    finite = [v for v in values if math.isfinite(v)]
    return number(which(finite), "") if finite else Missing("The filter has no path error there")


def _ratio(values: list[float]) -> Cell:
    finite = [v for v in values if math.isfinite(v)]
    return number(max(finite) / min(finite), "") if finite and min(finite) > 0 else Missing("No path error")


def _mean_nis(units: list[UnitResult], held_out: bool) -> Cell:
    found = [(u.held_out if held_out else u.evaluations).get("estimate") for u in units]
    values = [e.nis for e in found if e is not None]
    return number(float(np.mean(values)) if values else None, "The filter was not evaluated there")


def best_paths_plot(study: Study) -> Plot | None:
    """Path error over time of the best unit of each method, in one panel."""
    units = _first_dataset(study)
    best = [
        min(same, key=path_norm)
        for same in group(units, lambda r: r.method_label).values()
        if any(math.isfinite(path_norm(u)) for u in same)
    ]
    if len(best) < 2:
        return None
    caption = (
        f"Distance between estimated and true path, root mean square over {WINDOW_SHARE:.0%} of the samples, for the "
        f"unit of least path error of each method.{study.chosen()}"
    )
    return Plot("best-paths", "Best path error of each method", caption, partial(_draw_best, study, best))


def start_paths_plots(study: Study) -> list[Plot]:
    """Per method with several starts, path error over time from every start."""
    plots = []
    for method, units in group(_first_dataset(study), lambda r: r.method_label).items():
        known = [u for u in units if math.isfinite(path_norm(u))]
        if len(known) < 3:
            continue
        caption = (
            f"Distance between estimated and true path, root mean square over {WINDOW_SHARE:.0%} of the samples, for "
            f"{method} from {len(known)} starts; dotted, the filter at the truth.{study.chosen()}"
        )
        title = f"Path error of {method} from every start"
        plots.append(Plot(f"start-paths-{method}", title, caption, partial(_draw_starts, study, known)))
    return plots


def _first_dataset(study: Study) -> list[UnitResult]:
    return [r for r in study.results if r.dataset == study.results[0].dataset]


def _draw_best(study: Study, units: list[UnitResult]) -> Figure:
    figure, (axis,) = panels(1, 1, 2.6)
    colours = method_colours([r.method_label for r in study.results])
    for r in units:
        x, y, _ = path_error_curve(study, r, "estimate")
        axis.plot(x, y, color=colours[r.method_label], label=plot_text(r.method_label))
    return _finish(study, figure, axis, units[0])


def _draw_starts(study: Study, units: list[UnitResult]) -> Figure:
    figure, (axis,) = panels(1, 1, 2.6)
    colour = method_colours([r.method_label for r in study.results])[units[0].method_label]
    ordered = sorted(units, key=path_norm)
    for n, r in enumerate(ordered):
        x, y, _ = path_error_curve(study, r, "estimate")
        shade = 0.35 + 0.65 * n / (len(ordered) - 1)
        name = plot_text(f"{r.method_label}, {len(units)} starts") if n == len(ordered) - 1 else None
        axis.plot(x, y, color=colour, alpha=shade, linewidth=1.0, label=name)
    return _finish(study, figure, axis, units[0])


def _finish(study: Study, figure: Figure, axis: Axes, unit: UnitResult) -> Figure:
    """The curve at the truth, the labels of the axes, the legend."""
    label = path_error_curve(study, unit, "estimate")[2]
    if "truth" in unit.evaluations:
        x, y, _ = path_error_curve(study, unit, "truth")
        axis.plot(x, y, color=INK, linestyle=":", linewidth=1.2, label="truth")
    axis.set_xlabel(label)
    axis.set_ylabel(f"Path error [{plot_text(study.path_unit() or '1')}]")
    legend_above(figure, axis)
    return figure

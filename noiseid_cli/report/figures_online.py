"""Figures of online methods: unknowns, sensitivities and states over time."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from noiseid_cli.estimators.estimate import Series
from noiseid_cli.models.recording import Array
from noiseid_cli.outcome import UnitResult
from noiseid_cli.report.figure_style import BAND, INK, Plot, legend_above, log_axis, method_colours, panels, plot_text
from noiseid_cli.report.over_time import Track, drawn, held, online, series, spans, track, tracked_names
from noiseid_cli.report.study import Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_PANELS = 12
"""More unknowns or states than these get no panel."""

_TRUTH = {"color": INK, "linestyle": (0, (4, 2)), "linewidth": 1.0, "label": "truth"}


def online_plots(study: Study) -> list[Plot]:
    """Unknowns, sensitivities and states over time; none without online methods."""
    units = drawn(study)
    if not units:
        return []
    one = ""
    if len(units) < len(online(study)):
        one = f" Drawn is {units[0].dataset}, the first of the datasets and starts; the tables hold all."
    plots = [_parameters_plot(study, units, one)]
    plots += [_sensitivity_plot(study, r) for r in units if series(r, "sensitivity") is not None and _gated(r)]
    if any(series(r, "states") is not None for r in units):
        plots.append(_states_plot(study, units, one))
    return plots


def _gated(result: UnitResult) -> bool:
    gate = series(result, "open")
    return gate is not None and bool((gate.values < 0.5).any())


def _parameters_plot(study: Study, units: list[UnitResult], one: str) -> Plot:
    names = tracked_names(units)
    more = f" The first {MOST_PANELS} of {len(names)} unknowns are drawn." if len(names) > MOST_PANELS else ""
    caption = (
        "Estimates over time, with bands of two of their standard deviations where the method gives them; dashed, the "
        "truth. Of two methods the one that moves less sets the range of a panel, of more the one in the middle; "
        "arrows say how far the others go."
        f"{_held_words(study, units)}{more}{one}{study.chosen()}"
    )
    draw = partial(_draw_parameters, study, units, names[:MOST_PANELS])
    return Plot("unknowns-over-time", "Unknowns over time", caption, draw)


def _held_words(study: Study, units: list[UnitResult]) -> str:
    return " Grey: the motion is held." if any(held(study, r) for r in units) else ""


def _draw_parameters(study: Study, units: list[UnitResult], names: list[str]) -> Figure:
    figure, axes = panels(len(names), 1 if len(names) < 3 else 2, 1.8)
    colours = method_colours([r.method_label for r in study.results])
    for axis, name in zip(axes, names, strict=True):
        tracks = {r.method_label: t for r in units if (t := track(r, name)) is not None}
        for method, t in tracks.items():
            axis.plot(t.at, t.values, color=colours[method], label=plot_text(method))
            axis.fill_between(
                t.at, t.values - 2 * t.std, t.values + 2 * t.std, color=colours[method], alpha=0.18, linewidth=0
            )
        first = next(iter(tracks.values()))
        axis.plot(first.at, first.truth, **_TRUTH)  # type: ignore[arg-type]
        _shade(axis, held(study, units[0]))
        _frame(axis, tracks)
        axis.set_title(plot_text(f"{name} [{first.unit}]" if first.unit else name), loc="left")
        axis.margins(x=0.01)
    _below(axes, len(names))
    legend_above(figure, max(axes, key=lambda a: len(a.get_legend_handles_labels()[1])))
    return figure


def _frame(axis: Axes, tracks: dict[str, Track]) -> None:
    """Limits of the method in the middle, and what leaves them; logarithmic where it moves over two decades."""
    ranges = {method: (float(np.nanmin(t.values)), float(np.nanmax(t.values))) for method, t in tracks.items()}
    chosen = sorted(ranges, key=lambda method: ranges[method][1] - ranges[method][0])[(len(ranges) - 1) // 2]
    low, high = ranges[chosen]
    truth = np.concatenate([t.truth[np.isfinite(t.truth)] for t in tracks.values()])
    if len(truth):
        low, high = min(low, float(truth.min())), max(high, float(truth.max()))
    if low > 0 and high > 100 * low:
        log_axis(axis, "y")
        # A variance that touches its floor now and then would squeeze all the rest.
        usual = float(np.nanquantile(tracks[chosen].values, 0.1))
        bottom, top = min([usual, *truth]) / 3, high * 2
    else:
        margin = 0.08 * (high - low) or 0.08 * abs(high) or 1.0
        bottom, top = low - margin, high + margin
    axis.set_ylim(bottom, top)
    least, most = min(r[0] for r in ranges.values()), max(r[1] for r in ranges.values())
    beyond = (("↓", least, least < bottom), ("↑", most, most > top))
    text = " ".join(f"{arrow} {value:.3g}" for arrow, value, leaves in beyond if leaves)
    axis.text(1.0, 1.03, text, transform=axis.transAxes, ha="right", size=7.5)


def _shade(axis: Axes, span: tuple[float, float] | None, label: str | None = None) -> None:
    if span is not None:
        axis.axvspan(*span, color=BAND, alpha=0.22, linewidth=0, label=label)


def _below(axes: list[Axes], count: int) -> None:
    """Label of the time axis under the last row."""
    for axis in axes[-(2 if count > 2 else 1) :]:
        axis.set_xlabel("Time [s]")


def _sensitivity_plot(study: Study, result: UnitResult) -> Plot:
    caption = (
        f"Sensitivity of the states to each unknown in {result.unit}, over its largest value in the window and summed "
        "over the states: a posteriori, and in open loop where the model alone carries it on. Where the curve stays "
        "low, the data say nothing of the unknown. Hatched: the method holds it." + _held_words(study, [result])
    )
    title = f"Sensitivities of {result.method_label}"
    return Plot(f"sensitivities-{result.method_label}", title, caption, partial(_draw_sensitivity, study, result))


def _draw_sensitivity(study: Study, result: UnitResult) -> Figure:
    found, loop, gate = (series(result, name) for name in ("sensitivity", "sensitivity_open_loop", "open"))
    assert found is not None
    names = [column[0] for column in found.columns][:MOST_PANELS]
    states = series(result, "states")
    figure, axes = panels(len(names) + (states is not None), 1, 1.15)
    colour = method_colours([r.method_label for r in study.results])[result.method_label]
    if states is not None:
        _draw_state(axes[0], states, 0, colour, result.method_label)
        _draw_truth(axes[0], series(result, "states_true"), 0)
        _shade(axes[0], held(study, result))
    for axis, name in zip(axes[-len(names) :], names, strict=True):
        if loop is not None:
            axis.plot(loop.at, _column(loop, name), color=BAND, linewidth=0.8, label="open loop")
        axis.plot(found.at, _column(found, name), color=colour, label="a posteriori")
        _shade(axis, held(study, result))
        if gate is not None:
            for n, span in enumerate(spans(_column(gate, name) < 0.5, gate.at)):
                axis.axvspan(*span, facecolor="none", edgecolor=BAND, alpha=0.5, hatch="////", linewidth=0,
                             label="not adapted" if n == 0 else None)  # fmt: skip
        axis.set_title(plot_text(name), loc="left")
        axis.set_ylim(bottom=0)
        axis.margins(x=0.01)
    _below(axes, 1)
    shown = max(axes, key=lambda a: len(a.get_legend_handles_labels()[1]))
    legend_above(figure, shown)
    return figure


def _column(found: Series, name: str) -> Array:
    values: Array = found.values[:, [column[0] for column in found.columns].index(name)]
    return values


def _states_plot(study: Study, units: list[UnitResult], one: str) -> Plot:
    caption = "States estimated by each method; dashed, the true ones." + _held_words(study, units) + one
    return Plot("states-over-time", "States over time", caption, partial(_draw_states, study, units))


def _draw_states(study: Study, units: list[UnitResult]) -> Figure:
    found = [(r, s) for r in units if (s := series(r, "states")) is not None]
    columns = found[0][1].columns[:MOST_PANELS]
    figure, axes = panels(len(columns), 1, 1.35)
    colours = method_colours([r.method_label for r in study.results])
    for i, axis in enumerate(axes):
        for r, states in found:
            _draw_state(axis, states, i, colours[r.method_label], r.method_label)
        _draw_truth(axis, series(found[0][0], "states_true"), i)
        _shade(axis, held(study, found[0][0]))
    _below(axes, 1)
    legend_above(figure, axes[0])
    return figure


def _draw_state(axis: Axes, states: Series, i: int, colour: str, label: str) -> None:
    name, unit, _ = states.columns[i]
    axis.plot(states.at, states.values[:, i], color=colour, linewidth=1.1, label=plot_text(label))
    axis.set_title(plot_text(f"{name} [{unit}]" if unit else name), loc="left")
    axis.margins(x=0.01)


def _draw_truth(axis: Axes, states: Series | None, i: int) -> None:
    if states is not None:
        axis.plot(states.at, states.values[:, i], **_TRUTH)  # type: ignore[arg-type]

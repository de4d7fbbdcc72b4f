"""Figures of the filter against the data: path error, NIS and autocorrelation of the innovations."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from noiseid_cli.models.recording import Array
from noiseid_cli.outcome import UnitResult
from noiseid_cli.report.figure_style import (
    BAND,
    INK,
    Plot,
    legend_above,
    log_axis,
    method_colours,
    panels,
    plot_text,
)
from noiseid_cli.report.figures import MAX_PANELS, unit_labels, unit_styles
from noiseid_cli.report.reading import At, evaluation, featured
from noiseid_cli.report.study import Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WINDOW_SHARE = 0.02
"""Length of running means, as a share of the samples."""

MAX_POINTS = 400
"""Points per curve: more cannot be seen, and would make the page heavy."""


def time_axis(study: Study, result: UnitResult, samples: int) -> tuple[Array, str, list[slice]]:
    """(samples,) time of all tests laid end to end, the label of that axis, and where each test lies in it."""
    data = study.dataset(result.dataset)
    times = data.times if data else ()
    if not times or sum(len(t) for t in times) != samples:
        return np.arange(1.0, samples + 1), "Sample", [slice(0, samples)]
    pieces: list[Array] = []
    spans: list[slice] = []
    offset, place = 0.0, 0
    for t in times:
        pieces.append(t - t[0] + offset)
        spans.append(slice(place, place + len(t)))
        place += len(t)
        step = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
        offset = float(pieces[-1][-1]) + step
    return np.concatenate(pieces), "Time [s]" if len(times) == 1 else "Time, tests end to end [s]", spans


def running_mean(values: Array, window: int) -> Array:
    """Mean over the finite values in a centred window that shrinks at the ends; NaN where there is none."""
    seen = np.isfinite(values)
    total = np.concatenate(([0.0], np.cumsum(np.where(seen, values, 0.0))))
    count = np.concatenate(([0], np.cumsum(seen)))
    middle = np.arange(len(values))
    low, high = np.maximum(middle - window // 2, 0), np.minimum(middle + (window + 1) // 2, len(values))
    n = count[high] - count[low]
    out: Array = np.divide(total[high] - total[low], n, out=np.full(len(values), np.nan), where=n > 0)
    return out


def _smoothed(x: Array, values: Array, spans: list[slice], window: int) -> tuple[Array, Array]:
    """Running mean inside each test, thinned; tests are parted by NaN so that no line joins them."""
    xs: list[Array] = []
    ys: list[Array] = []
    border = np.array([np.nan])
    step = max(1, len(values) // MAX_POINTS)
    for span in spans:
        mean = running_mean(values[span], window)
        xs += [x[span][::step], border]
        ys += [mean[::step], border]
    return np.concatenate(xs), np.concatenate(ys)


def path_error_plot(study: Study) -> Plot | None:
    """Running root mean square of the path error, at start, estimate and truth."""
    units = [r for r in featured(study.results) if any(e.path_error is not None for e in r.evaluations.values())]
    if not units:
        return None
    caption = (
        f"Distance between estimated and true path, root mean square over {WINDOW_SHARE:.0%} of the samples."
        + _shown(units, study)
    )
    return Plot("path-error", "Path error over time", caption, partial(_draw_path_error, study, units))


def _draw_path_error(study: Study, units: list[UnitResult]) -> Figure:
    figure, axes = panels(len(units), 1, 1.75, share_y=True)
    for axis, r in zip(axes, units, strict=True):
        for at, found in r.evaluations.items():
            if found.path_error is not None:
                _time_curve(axis, study, r, at, found.path_error**2, root=True)
        axis.set_ylabel(f"Path error [{plot_text(study.path_unit() or '1')}]")
    _dress(figure, axes, study, units)
    return figure


def nis_plot(study: Study) -> Plot | None:
    """Running mean of the normalised innovation squared, with its 95 % band around 1."""
    units = [r for r in featured(study.results) if r.evaluations]
    if not units:
        return None
    caption = (
        f"Mean normalised innovation squared per measurement over {WINDOW_SHARE:.0%} of the samples. A consistent "
        "filter stays in the band around 1; above it the filter is over-confident." + _shown(units, study)
    )
    return Plot("nis", "NIS over time", caption, partial(_draw_nis, study, units))


def _draw_nis(study: Study, units: list[UnitResult]) -> Figure:
    figure, axes = panels(len(units), 1, 1.75, share_y=True)
    for axis, r in zip(axes, units, strict=True):
        for at, found in r.evaluations.items():
            _time_curve(axis, study, r, at, found.nis_time)
        # The mean over n white Gaussian measurements has a standard error of sqrt(2 / n).
        any_one = next(iter(r.evaluations.values()))
        n = _window(len(any_one.nis_time)) * any_one.observed / max(len(any_one.nis_time), 1)
        half = 1.96 * np.sqrt(2 / max(n, 1.0))
        axis.axhspan(max(1 - half, 0.0), 1 + half, color=BAND, alpha=0.3, linewidth=0, label="95 % band")
        axis.set_ylabel("NIS")
    _dress(figure, axes, study, units)
    return figure


def path_error_curve(study: Study, r: UnitResult, at: At) -> tuple[Array, Array, str]:
    """Times, running root mean square of the path error at one place, and the label of the time axis."""
    found = r.evaluations[at].path_error
    assert found is not None
    x, label, spans = time_axis(study, r, len(found))
    xs, ys = _smoothed(x, found**2, spans, _window(len(found)))
    return xs, np.sqrt(ys), label


def _window(samples: int) -> int:
    return max(1, round(WINDOW_SHARE * samples))


def _time_curve(axis: Axes, study: Study, r: UnitResult, at: str, values: Array, root: bool = False) -> None:
    """One curve over time: start dotted, tuning dotted in ink, estimate in the method's colour, truth in ink."""
    x, _, spans = time_axis(study, r, len(values))
    xs, ys = _smoothed(x, values, spans, _window(len(values)))
    ys = np.where(ys > 0, ys, np.nan)
    colour = method_colours([u.method_label for u in study.results])[r.method_label]
    look = {
        "tuning": {"color": INK, "linestyle": (0, (1, 1.2)), "linewidth": 1.0},
        "start": {"color": colour, "linestyle": (0, (1, 1.2)), "linewidth": 1.2},
        "estimate": {"color": colour, "linestyle": "-", "linewidth": 1.6},
        "truth": {"color": INK, "linestyle": (0, (4, 2)), "linewidth": 0.9},
    }[at]
    axis.plot(xs, np.sqrt(ys) if root else ys, label=at, **look)  # type: ignore[arg-type]


def _dress(figure: Figure, axes: list[Axes], study: Study, units: list[UnitResult]) -> None:
    """Titles, logarithmic axis, lines between tests, label of the time axis, one legend."""
    for axis, r, label in zip(axes, units, unit_labels(units, study), strict=True):
        x, x_label, spans = time_axis(study, r, len(next(iter(r.evaluations.values())).nis_time))
        for span in spans[1:]:
            axis.axvline(float(x[span.start]), color=BAND, linewidth=0.8)
        axis.set_title(label, loc="left")
        axis.set_xlabel(x_label if axis is axes[-1] else "")
        axis.margins(x=0.01)
        log_axis(axis, "y")
    legend_above(figure, axes[0])


def _shown(units: list[UnitResult], study: Study) -> str:
    if len(units) == len(study.results):
        return ""
    return f" {len(units)} of {len(study.results)} units are drawn: the best start of each method and dataset."


def autocorrelation_plot(study: Study) -> Plot | None:
    """Autocorrelation of the normalised innovations per output, with the 95 % bounds of white noise."""
    units = [r for r in featured(study.results) if evaluation(r, "estimate")]
    if not units:
        return None
    count = len(units[0].output_names)
    more = f" The first {MAX_PANELS} of {count} outputs are drawn." if count > MAX_PANELS else ""
    caption = (
        "Autocorrelation of the normalised innovations at the estimate. White innovations stay in the band at 95 % of "
        "the lags; more outside means that the model misses something." + more + _shown(units, study)
    )
    draw = partial(_draw_autocorrelation, study, units)
    return Plot("autocorrelation", "Autocorrelation of the innovations", caption, draw)


def _draw_autocorrelation(study: Study, units: list[UnitResult]) -> Figure:
    from matplotlib.ticker import MaxNLocator

    names = units[0].output_names
    figure, axes = panels(min(len(names), MAX_PANELS), 2, 1.9)
    looks = list(zip(units, unit_labels(units, study), unit_styles(units, study), strict=True))
    first = units[0].evaluations
    lags = np.arange(1, len(first["estimate"].autocorrelation) + 1)
    bound = 1.96 / np.sqrt(max(first["estimate"].observed / len(names), 1))
    for i, axis in enumerate(axes):
        for r, label, (colour, line) in looks:
            rho = r.evaluations["estimate"].autocorrelation[:, i]
            inside = colour if line == "-" else "none"
            axis.plot(lags, rho, "o", color=colour, linestyle=line, markersize=2.5, mfc=inside, label=label)
        if "truth" in first:
            rho = first["truth"].autocorrelation[:, i]
            axis.plot(lags, rho, color=INK, linestyle=":", linewidth=1.2, label="truth")
        axis.axhspan(-bound, bound, color=BAND, alpha=0.3, linewidth=0, label="95 % band")
        axis.set_title(plot_text(names[i][0]), loc="left")
        axis.set_ylabel("Correlation")
        axis.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 5, 10]))
    for axis in axes[-2:]:
        axis.set_xlabel("Lag [samples]")
    legend_above(figure, axes[0])
    return figure

"""Figures: what is drawn, with labels and units, in colours that can be seen."""

import numpy as np
import pytest
import report_cases

from noiseid_cli.report.figure_style import METHOD_COLOURS, method_colours, plot_text
from noiseid_cli.report.figures import convergence_plot, std_plots
from noiseid_cli.report.figures_time import (
    autocorrelation_plot,
    nis_plot,
    path_error_plot,
    running_mean,
    time_axis,
)


@pytest.fixture(scope="module")
def simulated():
    return report_cases.simulated(samples=240)


@pytest.fixture(scope="module")
def many():
    return report_cases.many(replicates=10, samples=60)


def luminance(colour):
    """Relative luminance of WCAG 2."""
    parts = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return linear @ [0.2126, 0.7152, 0.0722]


def contrast(a, b):
    high, low = sorted((luminance(a), luminance(b)), reverse=True)
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("ground", ["#ffffff", "#15181c"])
@pytest.mark.parametrize("colour", METHOD_COLOURS.values())
def test_colours_show_on_light_and_on_dark(colour, ground):
    assert contrast(colour, ground) >= 3


def test_colours_belong_to_methods():
    assert method_colours(["em-plain", "em"]) == {
        "em": METHOD_COLOURS["em"],
        "em-plain": METHOD_COLOURS["em-plain"],
    }
    colours = method_colours(["em", "my own", "another", "em"])
    assert colours["em"] == METHOD_COLOURS["em"]
    assert len(set(colours.values())) == 3
    assert colours == method_colours(["another", "em", "my own"])
    assert len(method_colours([f"m{i}" for i in range(25)])) == 25


def test_dollar_signs_start_no_formula():
    assert plot_text("$x$ \x1b") == r"\$x\$ \x1b"


@pytest.mark.parametrize("window", [1, 2, 5, 60])
def test_running_mean_equals_slow_loop(window):
    values = np.random.default_rng(0).normal(size=40)
    values[[0, 7, 8, 9, 20]] = np.nan
    values[25:36] = np.nan
    for i, mean in enumerate(running_mean(values, window)):
        part = values[max(i - window // 2, 0) : i + (window + 1) // 2]
        part = part[np.isfinite(part)]
        assert (np.isnan(mean) and not len(part)) or mean == pytest.approx(part.mean(), rel=1e-12, abs=1e-13)


def labels(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def test_every_axis_has_a_label_and_every_curve_a_name(simulated):
    plots = [convergence_plot(simulated), *std_plots(simulated), path_error_plot(simulated)]
    plots += [nis_plot(simulated), autocorrelation_plot(simulated)]
    for plot in plots:
        assert plot.caption
        assert plot.figure.axes[-1].get_xlabel()
        assert all(axis.get_ylabel() for axis in plot.figure.axes)
        assert labels(plot.figure)
    assert plots[1].figure.axes[0].get_ylabel() == "std(v) [N m]"
    assert plots[2].figure.axes[0].get_ylabel() == "Path error [m]"
    assert plots[2].figure.axes[-1].get_xlabel() == "Time, tests end to end [s]"
    assert labels(plots[3].figure) == ["start", "estimate", "truth", "95 % band"]


def test_convergence_draws_the_trace_and_marks_what_was_rejected(simulated):
    left, right = convergence_plot(simulated).figure.axes
    trace = simulated.results[0].estimate.trace
    kept = trace["accepted"] == 1
    np.testing.assert_array_equal(left.lines[0].get_xdata(), np.flatnonzero(kept) + 1)
    np.testing.assert_array_equal(left.lines[0].get_ydata(), trace["loglik"][kept])
    crosses = next(line for line in right.lines if line.get_marker() == "x" and len(line.get_xdata()))
    np.testing.assert_array_equal(crosses.get_xdata(), [7, 14])
    best = max(r.evaluations["estimate"].loglik for r in simulated.results)
    np.testing.assert_allclose(crosses.get_ydata(), best - trace["loglik"][[6, 13]])
    assert right.get_yscale() == "log"
    assert "rejected acceleration" in labels(left.figure)


def test_std_over_passes_reaches_the_estimate_beside_the_truth(simulated):
    axis = std_plots(simulated)[0].figure.axes[0]
    curve, truth = axis.lines[0], next(line for line in axis.lines if line.get_label() == "truth")
    assert curve.get_ydata()[-1] == pytest.approx(np.sqrt(simulated.results[0].estimate.trace["Q"][-1, 0, 0]))
    assert set(truth.get_ydata()) == {50.0}
    assert len(std_plots(simulated)) == 1
    assert [p.name for p in std_plots(report_cases.measured(samples=60))] == [
        "std-process-noise",
        "std-measurement-noise",
    ]


def test_autocorrelation_bounds_are_those_of_white_noise(simulated):
    axis = autocorrelation_plot(simulated).figure.axes[1]
    rho = simulated.results[0].evaluations["estimate"].autocorrelation[:, 1]
    np.testing.assert_array_equal(axis.lines[0].get_ydata(), rho)
    observed = simulated.results[0].evaluations["estimate"].observed
    assert axis.patches[0].get_height() == pytest.approx(2 * 1.96 / np.sqrt(observed / 4))


def test_many_units_are_drawn_by_a_few_and_a_range(many):
    plot = convergence_plot(many)
    left, right = plot.figure.axes
    assert len([line for line in left.lines if len(line.get_xdata())]) == 2
    assert len(right.collections) == 2
    assert "2 of 40 units are drawn" in plot.caption
    assert "Shaded" in plot.caption
    for plot in (path_error_plot(many), nis_plot(many)):
        assert len(plot.figure.axes) == 2
        assert "2 of 40" in plot.caption


def test_tests_are_laid_end_to_end(simulated):
    x, label, spans = time_axis(simulated, simulated.results[0], 240)
    assert label == "Time, tests end to end [s]"
    assert [(s.start, s.stop) for s in spans] == [(0, 120), (120, 240)]
    np.testing.assert_allclose(np.diff(x), 0.0005, rtol=1e-9)
    x, label, spans = time_axis(simulated, simulated.results[0], 17)
    assert (label, x[0], x[-1], len(spans)) == ("Sample", 1, 17, 1)


def test_nothing_to_draw():
    empty = report_cases.study([])
    assert convergence_plot(empty) is None
    assert std_plots(empty) == []
    assert path_error_plot(report_cases.measured(samples=60)) is None
    assert nis_plot(empty) is None
    assert autocorrelation_plot(empty) is None

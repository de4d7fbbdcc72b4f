"""Estimates over the number of tests of an ensemble: how a recursion approaches the estimate from all tests at once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from noiseid_cli.estimators.estimate import Series
from noiseid_cli.models.recording import Array
from noiseid_cli.outcome import UnitResult
from noiseid_cli.report.figure_style import INK, Plot, legend_above, method_colours, panels, plot_text
from noiseid_cli.report.reading import group
from noiseid_cli.report.study import Study
from noiseid_cli.report.tables import Cell, Column, Table, number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

REFERENCE = "batch-ml"
"""The method that uses all tests at once."""

NARROW = 0.3
"""Distance between the error bars of neighbouring methods, in tests."""


def over_tests(result: UnitResult, name: str = "over_tests") -> Series | None:
    """Curves of one result over the number of tests."""
    return next((s for s in result.estimate.series if s.name == name), None)


def ensemble_plot(study: Study) -> Plot | None:
    """Estimates and their errors over the number of tests, a panel for each unknown; None without a recursion."""
    units = [r for r in study.results if r.dataset == study.results[0].dataset and over_tests(r) is not None]
    if study.sweep or not any(len(_curve(r).at) > 1 for r in units):
        return None
    caption = (
        "Estimate after so many tests, with bars of one standard error. Circles: all those tests at once. Dashed: the "
        "truth; dotted: the sample moments of the first states that the tests really had, which no method sees."
        f"{study.chosen()}"
    )
    units = [next(iter(same)) for same in group(units, lambda r: r.method_label).values()]
    return Plot("over-tests", "Estimates over the number of tests", caption, partial(_draw, study, units))


def _curve(result: UnitResult) -> Series:
    found = over_tests(result)
    assert found is not None
    return found


def _draw(study: Study, units: list[UnitResult]) -> Figure:
    names = _curve(units[0]).columns
    figure, axes = panels(len(names), 2, 2.3)
    colours = method_colours([r.method_label for r in study.results])
    for i, (axis, (name, unit, _)) in enumerate(zip(axes, names, strict=False)):
        for k, r in enumerate(units):
            _draw_one(axis, r, i, NARROW * (k - (len(units) - 1) / 2), colours[r.method_label])
        _draw_truth(axis, units[0], i, name)
        axis.set_ylabel(plot_text(f"{name} [{unit}]" if unit else name))
        axis.set_xlabel("tests")
    legend_above(figure, axes[0])
    return figure


def _draw_one(axis: Axes, result: UnitResult, i: int, shift: float, colour: str) -> None:
    curve, errors = _curve(result), over_tests(result, "over_tests_errors")
    batch = result.estimate.method == REFERENCE
    bars = None if errors is None else errors.values[:, i]
    axis.errorbar(
        curve.at + shift, curve.values[:, i], yerr=bars, color=colour, elinewidth=0.8, capsize=1.5,
        fmt="o" if batch else "-", markersize=4, label=plot_text(result.method_label),
    )  # fmt: skip


def _draw_truth(axis: Axes, result: UnitResult, i: int, name: str) -> None:
    if result.parameters_true is not None and math.isfinite(result.parameters_true[i]):
        axis.axhline(result.parameters_true[i], color=INK, linestyle=(0, (4, 2)), linewidth=1.0, label="truth")
    sampled = over_tests(result, "sampled_truth")
    if sampled is None:
        return
    columns = [column for column, _, _ in sampled.columns]
    if name in columns:
        values = sampled.values[:, columns.index(name)]
        # The label stands in every panel's axis, so that the legend has it even if the first panel does not.
        axis.plot(sampled.at, values, color=INK, linestyle=":", linewidth=1.0, label="sampled")


def approach_table(study: Study) -> Table | None:
    """How far a recursion is from the estimate from all tests at once, over the number of tests.

    None without the two kinds of method. The ratio of mean square errors needs replicates and a truth.
    """
    rows: list[tuple[Cell, ...]] = []
    references = {r.dataset: r for r in study.results if r.estimate.method == REFERENCE and over_tests(r) is not None}
    others = [r for r in study.results if r.estimate.method != REFERENCE and over_tests(r) is not None]
    for label, units in group([r for r in others if r.dataset in references], lambda r: r.method_label).items():
        pairs = [(r, references[r.dataset]) for r in units]
        for count in _shared_counts(pairs):
            for i, (name, _, _) in enumerate(_curve(units[0]).columns):
                rows.append((label, count, name, *_compare(pairs, count, i), len(pairs)))
    if not rows or study.sweep:
        return None
    columns = (
        Column("Method"), Column("Tests"), Column("Unknown"), Column("Difference", "se", digits=2),
        Column("Mean square error / batch", decimals=3), Column("± Monte Carlo", decimals=3), Column("Replicates"),
    )  # fmt: skip
    caption = (
        "Difference: median distance from batch-ml over the same tests, in its standard errors. Ratio of mean square "
        "errors about the truth, over the replicates; its Monte Carlo error by the jackknife."
    )
    return Table("approach", "How the recursion approaches the batch estimate", caption, columns, tuple(rows), keys=3)


def _shared_counts(pairs: Sequence[tuple[UnitResult, UnitResult]]) -> list[int]:
    """Numbers of tests at which every result has an estimate."""
    sets = [set(_curve(r).at.tolist()) for pair in pairs for r in pair]
    return [int(n) for n in sorted(set.intersection(*sets))]


def _at(result: UnitResult, count: int, i: int, name: str = "over_tests") -> float:
    curve = over_tests(result, name)
    assert curve is not None
    return float(curve.values[curve.at.tolist().index(float(count)), i])


def _compare(pairs: Sequence[tuple[UnitResult, UnitResult]], count: int, i: int) -> tuple[Cell, Cell, Cell]:
    mine, batch = (np.array([_at(pair[k], count, i) for pair in pairs]) for k in (0, 1))
    errors = np.array([_at(pair[1], count, i, "over_tests_errors") for pair in pairs])
    difference = number(float(np.median(np.abs(mine - batch) / errors)), "No standard error")
    truths = [pair[0].parameters_true for pair in pairs]
    known = [t[i] for t in truths if t is not None]
    why = "Needs at least three replicates and a truth"
    if len(known) < max(len(pairs), 3) or not np.all(np.isfinite(known)):
        return difference, number(None, why), number(None, why)
    ratio, error = _jackknife((mine - known) ** 2, (batch - known) ** 2)
    return difference, number(ratio, why), number(error, why)


def _jackknife(a: Array, b: Array) -> tuple[float, float]:
    """Ratio of the means of two paired samples and its jackknife error."""
    n = len(a)
    left = (a.sum() - a) / (b.sum() - b)
    return float(a.sum() / b.sum()), float(np.sqrt((n - 1) / n * np.sum((left - left.mean()) ** 2)))

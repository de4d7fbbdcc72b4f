"""Tables and figures of a sweep: each point on its own, every figure recomputed from the results."""

from dataclasses import replace

import numpy as np
import pytest
import report_cases

from noiseid_cli.report.figure_style import style
from noiseid_cli.report.sections import sections
from noiseid_cli.report.study import SweepFacts
from noiseid_cli.report.summary import terminal_tables
from noiseid_cli.report.sweep import SHOWN, sweep_plots, sweep_table
from noiseid_cli.report.tables import Missing
from noiseid_cli.report.tidy import tidy_table

LENGTHS = (100, 10_000)


def swept(values, replicates=2, one=report_cases.unit):
    """One method at each value, on some replicates."""
    results = []
    for k, _ in enumerate(values):
        for n in range(replicates):
            unit = one("em", 0, replicate=n, samples=120)
            name = f"point-{k:03d}/{unit.unit}"
            results.append(replace(unit, unit=name, dataset=f"point-{k:03d}/replicate-{n:03d}"))
    of_unit = {r.unit: (values[k // replicates],) for k, r in enumerate(results)}
    return replace(report_cases.study(results, samples=120), sweep=SweepFacts(("length",), ("simulate.x",), of_unit))


@pytest.fixture(scope="module")
def lengths():
    return swept(LENGTHS)


def test_each_point_has_a_row_for_each_quantity(lengths):
    rows = sweep_table(lengths).rows
    assert [row[:3] for row in rows] == [("em", n, noise) for n in LENGTHS for noise in ("va1", "va2", "vm1", "vm2")]
    ends = [np.sqrt(r.estimate.final.Q[1, 1]) for r in lengths.results[:2]]
    truth = np.sqrt(lengths.results[0].Q_true[1, 1])
    assert rows[1][4] == "2 / 2"
    assert rows[1][5] == pytest.approx(np.mean(ends), rel=1e-14)
    assert rows[1][6] == pytest.approx(np.std(ends, ddof=1), rel=1e-10)
    assert rows[1][7] == pytest.approx(np.mean(ends) / truth, rel=1e-14)


def test_units_that_did_not_converge_are_counted_and_not_averaged(lengths):
    results = [report_cases.diverged(r) if k in (0, 2, 3) else r for k, r in enumerate(lengths.results)]
    rows = sweep_table(replace(lengths, results=results)).rows
    assert rows[0][4] == "1 / 2"
    assert rows[0][6] == Missing("Fewer than two units converged")
    assert rows[-1][1:5] == (10_000, "–", "–", "0 / 2")
    assert rows[-1][5] == Missing("No unit converged")


def test_without_a_truth_there_is_no_ratio_and_the_measured_noise_is_told_apart():
    study = swept(LENGTHS, 1, lambda *a, **k: report_cases.unit(*a, truth=False, estimates_R=True, **k))
    rows = sweep_table(study).rows
    assert "qm1 (measured)" in [row[2] for row in rows]
    assert all(row[7] == Missing("The truth is zero or not known") for row in rows)


def test_a_long_table_says_how_much_it_leaves_out():
    table = sweep_table(swept(tuple(range(60)), 1))
    assert len(table.rows) == SHOWN
    assert f"The first {SHOWN} of 240 rows" in table.caption


def test_the_figure_draws_every_unit_over_its_value(lengths):
    (plot,) = sweep_plots(lengths)
    with style():
        axes = plot.figure.axes
    assert len(axes) == 4
    assert {axis.get_xscale() for axis in axes} == {"log"}
    points, line = axes[0].get_lines()[:2]
    assert list(points.get_xdata()) == [100, 100, 10_000, 10_000]
    ratios = [np.sqrt(r.estimate.final.Q[0, 0] / r.Q_true[0, 0]) for r in lengths.results]
    assert list(points.get_ydata()) == pytest.approx(ratios, rel=1e-14)
    assert list(line.get_ydata()) == pytest.approx([np.median(ratios[:2]), np.median(ratios[2:])], rel=1e-14)


def test_values_that_are_no_numbers_are_ticks():
    (plot,) = sweep_plots(swept(("zero", "multi$ine"), 1))
    with style():
        labels = [tick.get_text() for tick in plot.figure.axes[-1].get_xticklabels()]
    assert labels == ["zero", r"multi\$ine"]
    assert sweep_plots(swept(("zero",), 2)) == []


def test_the_tidy_table_has_a_column_for_the_axis(lengths):
    table = tidy_table(lengths)
    at = [column.heading for column in table.columns].index("sweep_length")
    assert {(row[0][:9], row[at]) for row in table.rows} == {("point-000", 100), ("point-001", 10_000)}
    assert "sweep_length" not in [c.heading for c in tidy_table(replace(lengths, sweep=None)).columns]


def test_no_means_are_taken_over_points(lengths):
    many = swept(tuple(range(8)))
    assert [table.name for table in terminal_tables(many)] == ["summary", "sweep"]
    shown = {block.name for section in sections(many) for block in section.blocks if hasattr(block, "name")}
    assert "sweep" in shown
    assert not shown & {"recovery", "scores", "std-process-noise-means"}
    assert "recovery" in {
        block.name
        for section in sections(replace(many, sweep=None))
        for block in section.blocks
        if hasattr(block, "name")
    }

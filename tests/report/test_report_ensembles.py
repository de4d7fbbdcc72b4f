"""Tables and the figure of ensembles: every figure is recomputed from the results."""

from dataclasses import replace

import numpy as np
import report_cases

from noiseid_cli.estimators.estimate import Parameters, Series
from noiseid_cli.report.over_tests import approach_table, ensemble_plot
from noiseid_cli.report.parameter_recovery import parameter_recovery
from noiseid_cli.report.sections import sections
from noiseid_cli.report.side_by_side import side_by_side
from noiseid_cli.report.study import PublishedEstimates
from noiseid_cli.report.tables import Missing

NAMES = (("initial mean q", "rad", ""), ("initial variance q", "rad^2", ""), ("rate", "1/s", ""))
TRUTH = np.array([1.0, 0.25, 0.05])
SAMPLED = [[0.5, 0.1], [0.9, 0.3]]
COUNTS = {"batch-ml": (5.0, 20.0), "recursive-ml": tuple(np.arange(5.0, 21.0))}


def unit(method, replicate, rng, errors=(0.2, 0.04, 0.005)):
    """A result with scalars, curves over tests, and errors that are those it was drawn with."""
    errors = np.array(errors)
    at = np.array(COUNTS[method])
    spread = errors * np.sqrt(20 / at)[:, None]
    values = TRUTH + spread * rng.normal(size=spread.shape) * (1.0 if method == "batch-ml" else 1.5)
    series = (
        Series("over_tests", "", ("tests", ""), at, NAMES, values),
        Series("over_tests_errors", "", ("tests", ""), at, NAMES, spread),
        Series(
            "sampled_truth", "", ("tests", ""), np.array([2.0, 20.0]), NAMES[:2], np.array([[0.5, 0.1], [0.9, 0.3]])
        ),
    )
    found = Parameters(NAMES, np.zeros(3), values[-1], errors, (False, True, True))
    result = report_cases.unit(method, 0, replicate=replicate, samples=60)
    estimate = replace(result.estimate, method=method, parameters=found, series=series)
    return replace(result, method_label=method, estimate=estimate, parameters_true=TRUTH)


def study(replicates=1):
    rng = np.random.default_rng(5)
    units = [unit(method, k, rng) for k in range(replicates) for method in COUNTS]
    units = [replace(u, dataset=f"replicate-{u.replicate:03d}") for u in units]
    return report_cases.study(units, samples=60)


def test_methods_stand_side_by_side_with_what_is_printed():
    one = study()
    printed = {"batch-ml": {"rate": (0.054, None), "initial mean q": (1.27, 0.26)}}
    one = replace(one, estimates=PublishedEstimates("Table 1", printed, "Another draw.", "A paper"))
    table = side_by_side(one)
    headings = [c.heading for c in table.columns]
    assert headings[4:] == ["Sampled", "batch-ml", "recursive-ml", "batch-ml, printed"]
    mean, variance, rate = table.rows
    assert mean[4] == 0.9
    assert isinstance(rate[4], Missing)
    end = one.results[0].estimate.parameters
    assert mean[5] == f"{end.final[0]:.3g} ± 0.20"
    assert mean[7] == "1.27 ± 0.26"
    assert rate[7] == "0.0540"
    assert isinstance(variance[7], Missing)
    assert "Table 1 of A paper. Another draw." in table.caption


def test_one_method_alone_is_not_set_side_by_side():
    alone = study()
    assert side_by_side(replace(alone, results=alone.results[:1])) is None


def test_coverage_and_spread_are_those_of_the_replicates():
    many = study(80)
    table = parameter_recovery(many)
    values = np.array([r.estimate.parameters.final for r in many.results if r.method_label == "batch-ml"])
    row = next(row for row in table.rows if row[:2] == ("batch-ml", "initial mean q"))
    np.testing.assert_allclose(row[4:8], [values[:, 0].mean(), values[:, 0].std(ddof=1) / np.sqrt(80),
                                          values[:, 0].std(ddof=1), 0.2])  # fmt: skip
    share = np.mean(np.abs(values[:, 0] - 1.0) <= 0.2)
    assert row[8] == f"{100 * share:.1f} ± {100 * np.sqrt(share * (1 - share) / 80):.1f}"
    # A variance has its interval on the logarithm, which differs from the plain one.
    variance = next(row for row in table.rows if row[:2] == ("batch-ml", "initial variance q"))
    factor = np.exp(1.959963984540054 * 0.04 / values[:, 1])
    inside = (values[:, 1] / factor <= 0.25) & (values[:, 1] * factor >= 0.25)
    assert variance[10].startswith(f"{100 * inside.mean():.1f} ")


def test_the_ratio_of_mean_square_errors_is_that_of_the_curves():
    many = study(60)
    table = approach_table(many)
    rows = [row for row in table.rows if row[1] == 20]
    assert {row[1] for row in table.rows} == {5, 20}
    batch, recursive = (
        np.array([r.estimate.parameters.final for r in many.results if r.method_label == m]) for m in COUNTS
    )
    for i, row in enumerate(rows):
        a, b = ((found[:, i] - TRUTH[i]) ** 2 for found in (recursive, batch))
        np.testing.assert_allclose(row[4], a.mean() / b.mean(), rtol=1e-12)
        np.testing.assert_allclose(row[3], np.median(np.abs(recursive - batch)[:, i] / [0.2, 0.04, 0.005][i]))
        # Drawn with 1.5 times the spread: a ratio of 2.25, within four of its Monte Carlo errors.
        assert abs(row[4] - 2.25) < 4 * row[5]
    few = approach_table(study())
    assert all(isinstance(row[4], Missing) for row in few.rows)


def test_the_figure_has_a_panel_for_each_unknown_and_each_kind_of_truth():
    plot = ensemble_plot(study())
    figure = plot.figure
    assert [axis.get_ylabel() for axis in figure.axes] == [
        "initial mean q [rad]",
        "initial variance q [rad^2]",
        "rate [1/s]",
    ]
    labels = [line.get_label() for line in figure.axes[0].get_lines()]
    assert {"truth", "sampled"} <= set(labels)
    assert "sampled" not in [line.get_label() for line in figure.axes[2].get_lines()]


def test_a_report_shows_them_and_leaves_out_the_long_table():
    blocks = next(s for s in sections(study()) if s.anchor == "unknown-parameters").blocks
    names = [getattr(block, "name", "") for block in blocks]
    assert names == ["side-by-side", "over-tests", "approach"]
    names = [b.name for s in sections(study(20)) if s.anchor == "unknown-parameters" for b in s.blocks]
    assert "parameter-recovery" in names
    assert "parameter-estimates" not in names

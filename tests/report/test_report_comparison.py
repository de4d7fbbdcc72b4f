"""Methods side by side: every figure of the tables is recomputed from the results."""

from dataclasses import replace

import numpy as np
import pytest
import report_cases

from noiseid_cli.estimators.estimate import Uncertainty
from noiseid_cli.report.build import correlation_tables
from noiseid_cli.report.comparison import (
    best_paths_plot,
    path_norm,
    score_table,
    start_paths_plots,
)
from noiseid_cli.report.published import published_sentences, published_tables
from noiseid_cli.report.reading import correlation
from noiseid_cli.report.recovery import correlation_recovery_table, recovery_table
from noiseid_cli.report.sections import sections
from noiseid_cli.report.study import PublishedFacts
from noiseid_cli.report.tables import Missing
from noiseid_cli.report.tidy import metric_value, tidy_table


def with_held_out(result, tests=3):
    """The result with held-out evaluations of three times the path error."""
    held = {k: replace(e, path_error_norm=3 * e.path_error_norm, nis=2 * e.nis) for k, e in result.evaluations.items()}
    return replace(result, held_out=held, held_out_tests=tests)


@pytest.fixture(scope="module")
def starts():
    """Two methods from four starts each."""
    units = [report_cases.unit(m, s, samples=240) for m in ("em", "em-plain") for s in range(4)]
    return report_cases.study([with_held_out(u) for u in units], samples=240)


@pytest.fixture(scope="module")
def replicates():
    """One method on five replicates, two starts each."""
    units = [report_cases.unit("em", s, replicate=r, samples=120, dataset=f"r{r}") for r in range(5) for s in range(2)]
    return report_cases.study(units, samples=120)


def test_scores_are_the_extremes_over_the_units(starts):
    table = score_table(starts)
    for row in table.rows[:-1]:
        units = [r for r in starts.results if r.method_label == row[0]]
        ends = [u.evaluations["estimate"].path_error_norm for u in units]
        assert row[1:4] == (max(ends), min(ends), max(ends) / min(ends))
        assert row[4] == np.mean([u.evaluations["estimate"].nis for u in units])
        assert row[5:7] == (3 * max(ends) / np.sqrt(3), 3 * min(ends) / np.sqrt(3))
        assert row[7] == np.mean([2 * u.evaluations["estimate"].nis for u in units])
    truth = starts.results[0].evaluations["truth"].path_error_norm
    assert table.rows[-1][:3] == ("truth", truth, truth)


def test_without_held_out_tests_there_are_no_columns_for_them(starts):
    plain = replace(starts, results=[replace(r, held_out={}, held_out_tests=0) for r in starts.results])
    assert len(score_table(plain).columns) == len(score_table(starts).columns) - 3


def test_no_scores_without_a_true_path():
    assert score_table(report_cases.measured(samples=60)) is None


def test_recovery_averages_starts_and_spreads_over_replicates(replicates):
    table = recovery_table(replicates)
    assert len(table.rows) == 4
    for i, row in enumerate(table.rows):
        relative = []
        for r in range(5):
            units = [u for u in replicates.results if u.replicate == r]
            truth = np.sqrt(units[0].Q_true[i, i])
            relative.append(np.mean([np.sqrt(u.estimate.final.Q[i, i]) for u in units]) / truth - 1)
        assert row[4] == 5
        assert np.isclose(row[5], 100 * np.mean(relative))
        assert np.isclose(row[6], 100 * np.std(relative, ddof=1) / np.sqrt(5))
        assert np.isclose(row[7], 100 * np.std(relative, ddof=1))


def test_spread_stands_beside_the_bound(replicates):
    bound = {("process_noise_std", "va1"): 2.0, ("measurement_noise_std", "qm1"): 1e-8}
    table = recovery_table(replace(replicates, bounds={"em": bound}))
    row, plain = table.rows[0], recovery_table(replicates).rows[0]
    assert row[:8] == plain
    assert row[8] == pytest.approx(100 * 2.0 / 50.0)
    assert row[9] == pytest.approx(row[7] / row[8])
    assert "Of 5 replicates a spread, and a ratio with it, has a Monte Carlo error of 35 %" in table.caption
    assert isinstance(table.rows[1][9], Missing)


def with_errors(result, scale):
    """The result with intervals of 90 % that reach ``scale`` times 2 % to both sides of va1 and of one correlation."""
    Q = result.estimate.final.Q
    std, rho = np.sqrt(Q[0, 0]), correlation(Q)[1, 0]
    values, errors = np.array([std, rho]), scale * np.array([0.02 * std, 0.02])
    return replace(
        result,
        uncertainty=Uncertainty(
            method="score", level=0.9, values=values, standard_errors=errors, lower=values - errors,
            upper=values + errors, notes=("", ""), coordinates=(), information=np.zeros((0, 0)), shares=np.zeros(0),
            names=(("process_noise_std", "va1", "N m"), ("process_noise_correlation", "va2, va1", "")),
        ),
    )  # fmt: skip


def test_coverage_and_reported_errors_are_those_of_the_units(replicates):
    """Each replicate has two starts with the same data: one counts as one half."""
    scales = np.resize([0.2, 1.0, 3.0], len(replicates.results))
    units = [with_errors(r, scale) for r, scale in zip(replicates.results, scales, strict=True)]
    table = recovery_table(replace(replicates, results=units))
    titles = [c.title for c in table.columns]
    row = dict(zip(titles, table.rows[0], strict=True))
    ends = np.array([np.sqrt(u.estimate.final.Q[0, 0] / u.Q_true[0, 0]) for u in units])
    inside = np.abs(ends - 1) <= 0.02 * scales * ends
    assert 0.0 < inside.mean() < 1.0
    assert row["In 90 % interval [%]"] == f"{100 * inside.mean():.1f} ± {100 * np.sqrt(0.9 * 0.1 / 5):.1f}"
    assert row["Reported error [%]"] == pytest.approx(100 * np.mean(0.02 * scales * ends))
    assert row["Reported / spread"] == pytest.approx(row["Reported error [%]"] / row["Spread [%]"])
    assert isinstance(dict(zip(titles, table.rows[1], strict=True))["In 90 % interval [%]"], Missing)


def test_correlations_have_a_table_of_their_own(replicates):
    """All units have the true correlations: no bias, no spread, every interval holds the truth."""
    units = [with_errors(r, 1.0) for r in replicates.results]
    table = correlation_recovery_table(replace(replicates, results=units))
    assert len(table.rows) == 6
    row = dict(zip([c.title for c in table.columns], table.rows[0], strict=True))
    assert (row["Noise"], row["Replicates"]) == ("va2, va1", 5)
    assert row["Truth"] == pytest.approx(correlation(units[0].Q_true)[1, 0])
    assert row["Bias"] == pytest.approx(0.0, abs=1e-12)
    assert row["Reported error"] == pytest.approx(0.02)
    assert row["In 90 % interval [%]"].startswith("100.0 ")
    # A correlation that was given and held is not one that was found.
    held = [replace(u, estimate=replace(u.estimate, start=u.estimate.final)) for u in units]
    assert correlation_recovery_table(replace(replicates, results=held)) is None


def test_recovery_shows_measurement_noise_that_was_estimated(replicates):
    units = [report_cases.unit("em", 0, replicate=r, samples=60, dataset=f"r{r}", estimates_R=True) for r in range(3)]
    table = recovery_table(replace(replicates, results=units))
    assert [row[1] for row in table.rows] == ["va1", "va2", "vm1", "vm2", "qm1", "qm2", "acc1", "acc2"]
    ends = [np.sqrt(u.estimate.final.R[0, 0] / u.R_true[0, 0]) - 1 for u in units]
    assert table.rows[4][5] == pytest.approx(100 * np.mean(ends), abs=1e-12)
    assert "process noise" not in table.title


def test_recovery_needs_replicates(starts):
    assert recovery_table(starts) is None


def test_figures_of_path_errors(starts, replicates):
    assert len(best_paths_plot(starts).figure.axes[0].lines) == 3  # two methods and the truth
    plots = start_paths_plots(starts)
    assert [p.name for p in plots] == ["start-paths-em", "start-paths-em-plain"]
    assert all(len(p.figure.axes[0].lines) == 5 for p in plots)  # four starts and the truth
    assert best_paths_plot(replicates) is None
    assert start_paths_plots(replicates) == []


def published(metric="path_error_norm", index=""):
    rows = {"max": {"em": 0.3, "em-plain": 3.0, "absent": 6.0}, "std": {"em": 1.0}}
    return PublishedFacts("one", "A table", metric, index, "not printed", rows, "Look out.", "A poster")


def test_published_figures_stand_beside_ours(starts):
    (table,) = published_tables(replace(starts, published=[published()]))
    ends = {m: [path_norm(r) for r in starts.results if r.method_label == m] for m in ("em", "em-plain")}
    assert table.rows[0][:5] == ("max", "em", 4, max(ends["em"]), 0.3)
    assert table.rows[1][3:7] == (max(ends["em-plain"]), 3.0, max(ends["em-plain"]) / max(ends["em"]), 10.0)
    assert isinstance(table.rows[2][3], Missing)
    assert table.rows[3][3] == pytest.approx(np.std(ends["em"], ddof=1))
    assert "Look out." in table.caption
    assert "A poster" in table.caption


def test_sentences_say_what_was_found(starts):
    facts = replace(published(), rows={"max": {"em": 0.3, "em-plain": 3.0}, "min": {"em": 0.2, "em-plain": 1.0}})
    ends = {m: [path_norm(r) for r in starts.results if r.method_label == m] for m in ("em", "em-plain")}
    one, two = published_sentences(replace(starts, published=[facts]))
    assert f"is {max(ends['em']) / min(ends['em']):.4g} here, 1.5 published." in one
    assert f"its smallest is {min(ends['em-plain']) / min(ends['em']):.3g} times that of em here, 5 times" in two
    assert published_sentences(replace(starts, published=[published()])) == []


def test_any_metric_of_the_tidy_table_can_be_compared(starts):
    value, unit = metric_value(starts.results[0], "process_noise_std", "va2", starts)
    assert value == np.sqrt(starts.results[0].estimate.final.Q[1, 1])
    assert unit == "N m"
    assert metric_value(starts.results[0], "passes", "", starts)[0] == starts.results[0].estimate.passes
    assert metric_value(starts.results[0], "no_such", "", starts) == (None, "")


def test_held_out_figures_are_in_the_tidy_table(starts):
    rows = [r for r in tidy_table(starts).rows if r[7] == "held_out_estimate" and r[8] == "path_error_norm"]
    assert [r[10] for r in rows] == [r.held_out["estimate"].path_error_norm for r in starts.results]


def test_sections_show_them(starts):
    study = replace(starts, published=[published()], claims=["EM is best."])
    found = {s.heading: s for s in sections(study)}
    means, scores = found["How do the methods compare?"].blocks[:2]
    assert (means.name, scores) == ("summary", score_table(study))
    assert "EM is best." in found["How does this compare with what is published?"].blocks[-1].items


def test_captions_say_what_was_chosen(starts):
    sentence = "2 of 3 model parameters are chosen, not published."
    assert all(sentence in p.caption for p in (best_paths_plot(starts), *start_paths_plots(starts)))
    published_model = replace(
        starts.model, parameters=tuple(replace(p, source="poster") for p in starts.model.parameters)
    )
    assert "chosen" not in best_paths_plot(replace(starts, model=published_model)).caption


def test_correlations_are_held_against_the_truth(starts):
    table = correlation_tables(starts)[0]
    result = next(r for r in starts.results if r.unit in table.caption)
    largest = np.max(np.abs(correlation(result.estimate.final.Q) - correlation(result.Q_true)))
    assert f"Largest difference from the truth: {largest:.3f}." in table.caption

"""One table over several experiments: each cell is recomputed from the estimates that were put in."""

from dataclasses import replace

import numpy as np
import pytest
import report_cases
from test_report_comparison import with_errors

from noiseid_cli.report.tables import Missing
from noiseid_cli.report.validation import figures_table, validated, validation_table

N = 8


@pytest.fixture(scope="module")
def study():
    """Eight replicates of one start, with intervals of 95 % on two standard deviations."""
    units = [report_cases.unit("em", 0, replicate=r, samples=60, dataset=f"r{r}") for r in range(N)]
    units = [with_errors(u, scale) for u, scale in zip(units, np.resize([0.2, 3.0], N), strict=True)]
    # The correlations are exact in all of them: errors beside a spread of zero mean nothing.
    names = (("process_noise_std", "va1", "N m"), ("process_noise_std", "va2", "N m"))
    units = [replace(u, uncertainty=replace(u.uncertainty, level=0.95, names=names)) for u in units]
    bounds = {"em": {("process_noise_std", "va1"): 0.5, ("process_noise_std", "vm2"): 0.25}}
    return replace(report_cases.study(units, samples=60), bounds=bounds)


def ends(study, i):
    """Estimate and truth of standard deviation i over the replicates."""
    return np.sqrt([(u.estimate.final.Q[i, i], u.Q_true[i, i]) for u in study.results]).T


def test_a_row_over_the_figures_of_a_method(study):
    (found,) = validated(study)
    row = dict(
        zip([c.title for c in validation_table([found]).columns], validation_table([found]).rows[0], strict=True)
    )
    # Four standard deviations and six correlations.
    assert (row["Replicates"], row["Figures"]) == (N, 10)
    values, truth = ends(study, 0)
    spread = values.std(ddof=1)
    # All standard deviations of a unit are off by one factor; the correlations are exact.
    bias = 100 * (values / truth - 1)
    expected = f"{bias.mean():+.2f} ± {bias.std(ddof=1) / np.sqrt(N):.2f} %"
    assert row["Worst bias"].startswith(expected)
    told = [u.uncertainty for u in study.results]
    reported = np.mean([u.standard_errors for u in told], axis=0) / [spread, ends(study, 1)[0].std(ddof=1)]
    low, high = sorted(reported)
    assert row["Reported error / spread"] == f"{low:.3f} to {high:.3f} ± {1 / np.sqrt(2 * (N - 1)):.3f}"
    # The second interval is a correlation's, which holds no standard deviation of 20 N m.
    inside = np.array([u.lower[0] <= 50.0 <= u.upper[0] for u in told])
    per_replicate = inside / 2
    error = per_replicate.std(ddof=1) / np.sqrt(N)
    assert 0.0 < per_replicate.mean() < 0.5
    assert row["In 95 % interval [%]"] == f"{100 * per_replicate.mean():.1f} ± {100 * error:.1f}"
    ratios = sorted([spread / 0.5, ends(study, 3)[0].std(ddof=1) / 0.25])
    assert row["Spread / bound"] == f"{ratios[0]:.3f} to {ratios[1]:.3f} ± {1 / np.sqrt(2 * (N - 1)):.3f}"


def test_a_row_for_each_figure(study):
    table = figures_table(validated(study))
    row = dict(zip([c.title for c in table.columns], table.rows[0], strict=True))
    values, _ = ends(study, 0)
    assert (row["Figure"], row["In"]) == ("std va1", "N m")
    assert row["Spread"] == pytest.approx(values.std(ddof=1))
    assert row["Spread / bound"] == f"{values.std(ddof=1) / 0.5:.3f} ± {1 / np.sqrt(2 * (N - 1)):.3f}"
    assert isinstance(table.rows[2][7], Missing)
    assert [r[2] for r in table.rows[4:6]] == ["correlation va2, va1", "correlation vm1, va1"]


def test_what_was_known_is_no_figure(study):
    held = [replace(u, estimate=replace(u.estimate, start=u.estimate.final)) for u in study.results]
    assert validated(replace(study, results=held)) == []

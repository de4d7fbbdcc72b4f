"""Standard errors, intervals, the tuning in use and where the misfit sits, in tables, pages and results.csv."""

from dataclasses import replace

import numpy as np
import pytest
from report_cases import unit

from noiseid_cli.diagnostics.where import Misfit
from noiseid_cli.estimators.estimate import Uncertainty
from noiseid_cli.report import ModelFacts, Study, make_report
from noiseid_cli.report.before_after import before_after_table
from noiseid_cli.report.build import std_table
from noiseid_cli.report.certainty import certainty_sentences, certainty_tables
from noiseid_cli.report.diagnosis import case_of, output_table, overall_table, verdict, where_table
from noiseid_cli.report.tables import Missing
from noiseid_cli.report.tidy import tidy_table


@pytest.fixture
def study():
    """One unit with errors of two noises, one of them at zero; a tuning; held-out data; misfit against a speed."""
    r = unit("em", 0)
    names = (("process_noise_std", "va1", "N m"), ("process_noise_std", "vm1", "N m"),
             ("process_noise_correlation", "vm1, va1", ""))  # fmt: skip
    sure = Uncertainty(
        "score", 0.9, names, np.array([50.0, 1.0, 0.2]), np.array([2.5, 3.0, np.nan]), np.array([46.0, 0.0, -1.0]),
        np.array([54.25, 6.0, 1.0]), ("", "zero is not excluded: one-sided", "not determined: may be zero"),
        ("Q va1",), np.eye(1), np.array([0.3]), ("The data say least about the std of va1.",), ("A ridge of two.",),
    )  # fmt: skip
    end = r.evaluations["estimate"]
    misfit = Misfit("w <2>", "rad/s", np.array([-2.0, 0.0, 3.0]), np.array([0.5, 1.5]), np.array([2400.0, 2400.0]))
    end = replace(end, misfit=(misfit,))
    tuning = replace(r.evaluations["start"], label="tuning")
    return Study(
        "One", "one",
        [replace(r, uncertainty=sure, evaluations={"tuning": tuning, **r.evaluations, "estimate": end},
                 held_out={"tuning": tuning, "estimate": end}, Q_tuning=4 * r.estimate.final.Q, held_out_tests=1)],
        ModelFacts("m", "A model."),
    )  # fmt: skip


def test_standard_deviations_have_errors_and_intervals(study):
    table = std_table(study, "Q")
    headings = [column.heading for column in table.columns]
    rows = {row[1]: dict(zip(headings, row, strict=True)) for row in table.rows}
    assert (rows["va1"]["±"], rows["va1"]["Interval"]) == (2.5, "46.0 to 54.2")
    assert (rows["vm1"]["±"], rows["vm1"]["Interval"]) == (3.0, "0 to 6.00")
    assert isinstance(rows["va2"]["±"], Missing)
    assert "90\u00a0%" in table.caption


def test_what_is_not_determined_says_why(study):
    rows = {row[1]: row for row in certainty_tables(study)[0].rows}
    assert rows["vm1, va1"][4] == Missing("not determined: may be zero")
    assert rows["vm1, va1"][5] == "-1.00 to 1.00"
    told = certainty_sentences(study)
    assert [text.split(": ")[1] for text in told] == ["A ridge of two.", "The data say least about the std of va1."]


def test_head_of_the_report_shows_tuning_and_held_out_data(study, tmp_path):
    table = before_after_table(study)
    assert [row[1] for row in table.rows] == ["tuning", "start", "estimate", "truth"]
    assert [column.heading for column in table.columns][4:6] == ["Log-likelihood, held out", "NIS, held out"]
    page = make_report(study, tmp_path, ("md", "html", "svg")).markdown.read_text()
    order = [page.index(text) for text in ("A ridge of two", "## What does", "## How sure", "## Does the")]
    assert order == sorted(order)
    assert "w <2>" not in (tmp_path / "report.html").read_text()
    assert (tmp_path / "figures" / "misfit.svg").stat().st_size > 1000


def test_diagnosis_tables_show_bounds_and_the_worst_range(study):
    case = case_of(study.results[0])
    overall = overall_table([case])
    assert [row[1] for row in overall.rows].count("held out") == 2
    low, high = study.results[0].evaluations["estimate"].nis_bounds()
    assert f"{low:.3f} to {high:.3f}" in overall.rows[0]
    assert len(output_table([case], "estimate").rows) == 4
    where = where_table([case], "estimate")
    assert where is not None
    assert where.rows[0][1:6] == ("w <2>", pytest.approx(50, abs=1), "0 to 3", "rad/s", 1.5)
    assert where_table([case], "truth") is None
    text = " ".join(verdict(case, "estimate"))
    assert "The misfit follows w <2>" in text
    assert "that of the covariances in use" in text
    assert "failed there" in verdict(replace(case, evaluations={}), "estimate")[0]


def test_results_csv_has_errors_bounds_and_misfit(study):
    rows = {(row[7], row[8], row[9]): row[10] for row in tidy_table(study).rows}
    assert rows["estimate", "process_noise_std_standard_error", "va1"] == 2.5
    assert rows["estimate", "process_noise_std_upper", "vm1"] == 6.0
    assert rows["tuning", "process_noise_std", "va1"] == pytest.approx(2 * rows["estimate", "process_noise_std", "va1"])
    assert rows["estimate", "misfit_nis", "w <2>, 2"] == 1.5
    assert rows["held_out_estimate", "nis_lower_bound", ""] < 1
    assert 0.9 < rows["truth", "inside_band", "qm2"] < 1

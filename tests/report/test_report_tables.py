"""Numbers in tables are the numbers in the results."""

import csv
import io
from dataclasses import replace

import numpy as np
import pytest
import report_cases

from noiseid_cli.report import terminal_tables
from noiseid_cli.report.agreement import consistency_table, start_sentences, starts_table
from noiseid_cli.report.before_after import before_after_table
from noiseid_cli.report.build import (
    correlation_tables,
    ending_table,
    std_summary_table,
    std_table,
    summary_table,
)
from noiseid_cli.report.reading import best, covariance_unit, featured, remark
from noiseid_cli.report.render_csv import csv_table
from noiseid_cli.report.render_html import html_table
from noiseid_cli.report.render_latex import latex_table
from noiseid_cli.report.render_markdown import markdown_table
from noiseid_cli.report.render_terminal import terminal_table
from noiseid_cli.report.shown import with_short_names
from noiseid_cli.report.tables import Column, Missing, Table, number, write_number
from noiseid_cli.report.tidy import tidy_table


@pytest.fixture(scope="module")
def simulated():
    return report_cases.simulated(samples=240)


@pytest.fixture(scope="module")
def many():
    return report_cases.many(replicates=10, samples=60)


@pytest.mark.parametrize(
    ("value", "column", "text"),
    [
        (1.23456, Column("a"), "1.235"),
        (0.00012345, Column("a"), "1.234e-4"),
        (0.0012345, Column("a"), "0.001234"),
        (123456.7, Column("a"), "123457"),
        (1234567.0, Column("a"), "1.235e6"),
        (999999.9, Column("a"), "1.000e6"),
        (0.99999, Column("a"), "1.000"),
        (-5e-12, Column("a", digits=2), "-5.0e-12"),
        (0.0, Column("a"), "0"),
        (70000.128, Column("a", decimals=2), "70000.13"),
        (-0.001, Column("a", decimals=2), "0.00"),
        (12, Column("a", digits=1), "12"),
        (1e-300, Column("a"), "1.000e-300"),
    ],
)
def test_numbers_are_written_by_significant_digits(value, column, text):
    assert str(write_number(value, column)) == text


def test_powers_of_ten_in_each_format():
    table = Table("t", "T", "", (Column("a", "m"),), ((-1.5e-12,),))
    assert "−1.500 × 10<sup>−12</sup>" in html_table(table)
    assert r"$-1.500 \times 10^{-12}$" in latex_table(table)
    assert "| -1.500e-12 |" in markdown_table(table)
    assert "-1.500e-12" in terminal_table(table)
    assert csv_table(table) == "a [m]\n-1.5e-12\n"


def test_what_is_not_finite_is_missing_with_a_reason():
    for value in (float("nan"), float("inf"), -float("inf"), None):
        assert number(value, "why") == Missing("why")
    with pytest.raises(ValueError, match="not finite"):
        Table("t", "", "", (Column("a"),), ((float("nan"),),))
    with pytest.raises(ValueError, match="2 cells under 1 columns"):
        Table("t", "", "", (Column("a"),), ((1.0, 2.0),))


def test_reasons_are_listed_once_and_referred_to():
    table = Table("t", "T", "", (Column("a"), Column("b")), ((Missing("x"), Missing("y")), (Missing("y"), 1.0)))
    assert table.notes() == ["x", "y"]
    assert "| – (2) | 1.000 |" in markdown_table(table)
    assert "(2) y." in terminal_table(table)
    assert "–<sup>2</sup>" in html_table(table)
    assert "--$^{2}$" in latex_table(table)
    assert csv_table(table) == "a,b\n,\n,1.0\n"


@pytest.mark.parametrize("width", [40, 60, 100, 300])
def test_terminal_tables_fit_and_repeat_their_keys(simulated, width):
    table = starts_table(simulated)
    lines = terminal_table(table, width).split("\n")
    blocks = sum(line.startswith("Method") for line in lines)
    widest = max(len(line) for line in lines)
    keys_and_widest = len("em-plain  simulated  Replicate") + len("  Log-likelihood")
    assert widest <= max(width, keys_and_widest)
    assert blocks == {40: 6, 60: 3, 100: 1, 300: 1}[width]
    assert sum(line.startswith("em-plain") for line in lines) == blocks


def test_a_wide_table_breaks_its_headings_first():
    columns = (Column("Unit"), Column("Log-likelihood gained", decimals=0), Column("Path error, estimate", "m"))
    table = Table("t", "T", "", columns, (("a", 12.0, 0.5),))
    assert terminal_table(table, 60).split("\n")[2:6] == [
        "Unit  Log-likelihood gained  Path error, estimate",
        "                                              [m]",
        "─" * 49,
        "a                        12                0.5000",
    ]
    assert terminal_table(table, 35).split("\n")[2:7] == [
        "      Log-likelihood  Path error,",
        "Unit          gained     estimate",
        "                              [m]",
        "─" * 33,
        "a                 12       0.5000",
    ]


def read(table):
    return list(csv.DictReader(io.StringIO(csv_table(table))))


def test_tidy_table_holds_the_results_bit_for_bit(simulated):
    rows = read(tidy_table(simulated))
    found = {(r["unit"], r["at"], r["metric"], r["index"]): r["value"] for r in rows}
    assert len(found) == len(rows)
    for result in simulated.results:
        assert float(found[result.unit, "", "passes", ""]) == result.estimate.passes
        assert float(found[result.unit, "", "seconds", ""]) == result.seconds
        assert int(found[result.unit, "", "seed", ""]) == result.seed
        for at, e in result.evaluations.items():
            assert float(found[result.unit, at, "loglik", ""]) == e.loglik
            assert float(found[result.unit, at, "nis", ""]) == e.nis
            assert float(found[result.unit, at, "path_error_norm", ""]) == e.path_error_norm
            for i, (name, _, _) in enumerate(result.output_names):
                assert float(found[result.unit, at, "ljung_box_p", name]) == e.ljung_box[i]
                assert float(found[result.unit, at, "kurtosis", name]) == e.kurtosis[i]
                assert float(found[result.unit, at, "autocorrelation", f"{name}, 7"]) == e.autocorrelation[6, i]
        Q = result.estimate.final.Q
        assert float(found[result.unit, "estimate", "process_noise_covariance", "vm1, va2"]) == Q[2, 1]
        assert float(found[result.unit, "estimate", "process_noise_std", "va2"]) == np.sqrt(Q[1, 1])
        rho = Q[2, 1] / np.sqrt(Q[1, 1] * Q[2, 2])
        stored = float(found[result.unit, "estimate", "process_noise_correlation", "vm1, va2"])
        assert stored == pytest.approx(rho, rel=1e-14)
    units = {r["index"]: r["value_unit"] for r in rows if r["metric"] == "measurement_noise_covariance"}
    assert units["acc1, acc1"] == "(m/s^2)^2"
    assert units["acc1, qm1"] == "(m/s^2) (rad)"


def test_tidy_table_says_why_a_value_is_empty():
    gone = report_cases.diverged(report_cases.unit("em", 0, samples=60))
    rows = read(tidy_table(report_cases.study([gone], samples=60)))
    empty = [r for r in rows if not r["value"]]
    assert empty
    assert all(r["note"] == "Not available: the unit ended as diverged" for r in empty)
    assert {r["status"] for r in rows} == {"diverged"}
    assert all(np.isfinite(float(r["value"])) for r in rows if r["value"])


def test_before_and_after_in_full(simulated):
    table = before_after_table(simulated)
    result = simulated.results[1]
    # In these cases the truth differs from unit to unit.
    for row, at in zip(table.rows[3:6], ("start", "estimate", "truth"), strict=True):
        e = result.evaluations[at]
        assert row == (result.unit, at, e.loglik, e.nis, e.path_error_norm)
    assert [c.title for c in table.columns][-1] == "Path error [m]"
    assert ending_table(simulated).rows[1][:4] == (result.unit, "× 100", "converged", 40)


def test_the_truth_of_one_dataset_has_one_row(simulated):
    shared = simulated.results[0].evaluations["truth"]
    same = [replace(r, evaluations=r.evaluations | {"truth": shared}) for r in simulated.results]
    table = before_after_table(replace(simulated, results=same))
    assert [row[1] for row in table.rows] == ["start", "estimate"] * 4 + ["truth"]
    assert table.rows[-1] == ("all", "truth", shared.loglik, shared.nis, shared.path_error_norm)


def test_std_table_marks_what_was_held(simulated):
    rows = std_table(simulated, "Q").rows
    result = simulated.results[0]
    end = np.sqrt(result.estimate.final.Q[1, 1])
    assert rows[1] == (result.unit, "va2", "N m", 2.0, end, 20.0, end / 20.0, "estimated")
    held = std_table(simulated, "R").rows
    assert [row[0] for row in held] == ["all"] * 4
    assert {row[-1] for row in held} == {"held"}
    gone = report_cases.diverged(report_cases.unit("em", 0, samples=60))
    assert remark(gone, "R", 0) == "held"
    still = report_cases.unit("em", 0, samples=60)
    object.__setattr__(still.estimate, "final", still.estimate.start)
    assert remark(still, "Q", 0) == "unchanged"


def test_without_truth_no_column_speaks_of_it():
    study = report_cases.measured(samples=120)
    for table in (before_after_table(study), std_table(study, "Q"), consistency_table(study)):
        assert not any("truth" in c.heading.lower() for c in table.columns)
        assert not any(cell == "truth" for row in table.rows for cell in row)
    assert not any("Path error" in c.heading for c in before_after_table(study).columns)
    assert std_table(study, "R").rows[0][-1] == "estimated"
    assert std_table(study, "Q").rows[0][3:5] == (5.0, np.sqrt(study.results[0].estimate.final.Q[0, 0]))


def test_correlations_of_the_best_units(simulated):
    tables = correlation_tables(simulated)
    assert [t.title.split(", ")[-1] for t in tables] == ["em", "em-plain"]
    assert tables[0].rows[0][1:] == pytest.approx([1.0, 0.2, 0.2, 0.2])


def test_means_use_converged_units_only(many):
    table = summary_table(many)
    for row in table.rows:
        units = [r for r in many.results if r.method_label == row[0]]
        used = [r for r in units if r.estimate.status == "converged"]
        assert row[1] == f"{len(used)} / {len(units)}"
        assert 0 < len(used) < len(units)
        assert row[5] == pytest.approx(np.mean([u.evaluations["estimate"].nis for u in used]))
    stds = std_summary_table(many, "Q")
    used = [r for r in many.results if r.method_label == "em" and r.estimate.status == "converged"]
    ends = [np.sqrt(r.estimate.final.Q[0, 0]) for r in used]
    assert stds.rows[0][3] == f"{len(used)} / 20"
    assert stds.rows[0][4:7] == pytest.approx((np.mean(ends), np.std(ends, ddof=1), np.mean(ends) / 50))
    assert std_summary_table(many, "R").rows[0][5:] == (0.0, pytest.approx(1.0), "held")


def test_no_mean_where_nothing_converged():
    gone = [report_cases.diverged(report_cases.unit("em", s, samples=60)) for s in (0, 1)]
    study = report_cases.study(gone, samples=60)
    assert set(summary_table(study).rows[0][2:]) == {Missing("No unit converged")}
    assert start_sentences(study) == ["em: fewer than two starts converged, so nothing can be compared."]
    assert starts_table(study).rows[0][4] == Missing("Fewer than two starts converged")
    assert std_summary_table(study, "Q").rows[0][4:6] == (
        Missing("No unit converged"),
        Missing("Fewer than two units converged"),
    )


def test_measurement_noise_is_shown_in_quantisation_steps_too():
    study = report_cases.measured(samples=60)
    name = study.results[0].output_names[0][0]
    plain = std_table(study, "R")
    assert all(column.heading != "In steps" for column in plain.columns)
    stepped = replace(study, datasets=[replace(d, steps={name: 2e-6}) for d in study.datasets])
    table = std_table(stepped, "R")
    at = [column.heading for column in table.columns].index("In steps")
    own = [row for row in table.rows if row[1] == name]
    ends = [np.sqrt(r.estimate.final.R[0, 0]) for r in stepped.results]
    assert [row[at] for row in own] == pytest.approx([end / 2e-6 for end in ends])
    assert {row[at] for row in table.rows if row[1] != name} == {Missing("The output does not move in steps")}
    assert "rounding alone is 0.29" in table.caption
    assert std_table(stepped, "Q") == std_table(study, "Q")


def test_starts_are_compared_within_one_dataset(simulated, many):
    row = starts_table(simulated).rows[0]
    ends = [np.sqrt(r.estimate.final.Q[0, 0]) for r in simulated.results[:2]]
    assert row[:4] == ("em", "simulated", 0, "2 / 2")
    assert row[5] == pytest.approx(100 * (max(ends) - min(ends)) / np.mean(ends))
    assert len(starts_table(many).rows) == 20
    assert "same optimum" in start_sentences(simulated)[0]
    far = report_cases.simulated(samples=60)
    object.__setattr__(far.results[0].evaluations["estimate"], "loglik", 69_990.0)
    assert start_sentences(far)[:2] == [
        "em: the starts end apart; the largest spread of log-likelihood is 10.",
        "em on simulated: these starts ended below the best: × 0.01 (-10).",
    ]


def test_many_units_get_means_and_a_few_examples(many):
    assert [t.name for t in terminal_tables(many)] == [
        "summary",
        "scores",
        "recovery",
        "recovery-correlations",
        "std-process-noise-means",
        "starts",
    ]
    assert len(before_after_table(many).rows) == 120
    assert {row[0] for row in consistency_table(many).rows} == {r.unit for r in best(many.results)}
    assert len(featured(many.results)) == 2
    assert [r.estimate.status for r in best(many.results)] == ["converged", "converged"]


def test_terminal_tables_of_few_and_of_none(simulated):
    first = ["endings", "before-after", "std-process-noise"]
    assert [t.name for t in terminal_tables(simulated)] == [*first, "starts"]
    assert [c.heading for c in terminal_tables(simulated)[0].columns] == ["Unit", "Start", "Status", "Passes", "Time"]
    # Nothing is known of the truth there, and R was estimated.
    single = report_cases.measured(samples=60)
    assert [t.name for t in terminal_tables(single)] == [*first, "std-measurement-noise", "consistency"]
    assert terminal_tables(report_cases.study([])) == []


def test_units_of_covariances():
    names = (("a", "N m", ""), ("b", "", ""), ("c", "", ""))
    assert [covariance_unit(names, i, j) for i, j in ((0, 0), (1, 0), (2, 1))] == ["(N m)^2", "(1) (N m)", ""]


def test_the_terminal_leaves_out_a_column_of_one_word(simulated):
    shown = next(t for t in terminal_tables(simulated) if t.name == "std-process-noise")
    assert [c.heading for c in shown.columns][-1] == "Estimate / truth"
    full = std_table(with_short_names(simulated), "Q")
    assert [row[:-1] for row in full.rows] == list(shown.rows)
    assert {row[-1] for row in full.rows} == {"estimated"}

"""Unknowns over time in a report: tracks, errors, settling, drift in a hold, figures."""

from dataclasses import replace

import numpy as np
import online_cases as cases
import pytest
import report_cases

from noiseid_cli.report import make_report, terminal_tables
from noiseid_cli.report.figures_online import online_plots
from noiseid_cli.report.over_time import change_times, online, spans, track
from noiseid_cli.report.tables import Missing
from noiseid_cli.report.tidy import tidy_table
from noiseid_cli.report.tracking import hold_table, settling_time, tracking_sentences, tracking_table


def row(table, method, unknown):
    (cells,) = [r for r in table.rows if r[:2] == (method, unknown)]
    return dict(zip([c.heading for c in table.columns], cells, strict=True))


def first_point_after(time):
    """The curves have a point each 0.05 s."""
    step = cases.AT[1]
    return pytest.approx(time + step / 2, abs=step / 2 + 1e-9)


def test_bias_spread_and_rmse_are_those_of_the_curves():
    """The last quarter: the error has decayed to what BIAS says, up to exp(-3) of the old estimate's distance."""
    found = row(tracking_table(cases.study()), "asrukf", "m")
    assert found["Seeds"] == "3 / 3"
    assert found["Truth"] == 2.0
    assert found["Bias"] == pytest.approx(3.0, abs=1e-3)  # seeds: 2, 3 and 4 %
    assert found["± Monte Carlo"] == pytest.approx(1 / 3**0.5, abs=1e-3)
    assert found["RMSE"] == pytest.approx((29 / 3) ** 0.5, abs=1e-3)
    assert row(tracking_table(cases.study()), "sb-asrukf", "v_q")["Bias"] == pytest.approx(900, abs=1)


def test_each_unit_has_its_errors_in_the_long_table():
    """Of the first seed: 2 % and what is left of the start."""
    table = tidy_table(cases.study())
    at = [c.heading for c in table.columns].index("metric")
    found = {r[at : at + 4] for r in table.rows if r[0] == "replicate-000/asrukf/start-0" and "track" in str(r[at])}
    values = {(metric, name): value for metric, name, value, _ in found}
    assert {unit for *_, unit in found} == {""}
    assert values["tracking_bias", "m"] == pytest.approx(0.02, abs=1e-5)
    assert values["tracking_rmse", "m"] == pytest.approx(0.02, abs=1e-5)
    assert values["tracking_bias", "mu"] == pytest.approx(-0.04, abs=1e-4)
    assert len(values) == 6


def test_settling_starts_anew_where_the_truth_changes():
    t = track(cases.unit("sb-asrukf"), "mu")
    expected = np.log(0.10 / (0.1 * 0.05))  # 0.05 + 0.10 exp(-t) within 10 % of 0.05
    assert settling_time(t, 0.0, cases.CHANGE) == first_point_after(expected)
    # From the change on it stands for the 4 s of the hold, then moves from 0.05 to 0.10.
    assert settling_time(t, cases.CHANGE) == first_point_after(4 + np.log(0.05 / 0.01))
    table = tracking_table(cases.study())
    assert row(table, "sb-asrukf", "mu")["Settled"] == first_point_after(expected)
    assert row(table, "sb-asrukf", "mu")["Settled from 8 s on"] == first_point_after(5.6094)
    assert row(table, "asrukf", "v_q")["Settled"] == Missing("Half of the seeds or more do not stay within 10%")


def test_time_to_settle_of_made_up_errors():
    base = track(cases.unit("asrukf"), "m")

    def made(error):
        return replace(base, truth=np.ones(401), values=1 + np.asarray(error))

    flat = np.zeros(401)
    assert settling_time(made(flat)) == 0.0
    late = flat.copy()
    late[100] = -0.12
    assert settling_time(made(late)) == pytest.approx(cases.AT[101])
    assert settling_time(made(late), 5.05) == 0.0
    late[400] = 0.12
    assert settling_time(made(late)) == np.inf
    assert settling_time(made(late), end=20.0) == pytest.approx(cases.AT[101])
    late[50] = np.nan
    assert settling_time(made(late), end=3.0) == pytest.approx(cases.AT[51])
    assert np.isnan(settling_time(replace(base, truth=np.zeros(401))))


def test_drift_in_the_hold_and_the_way_back():
    table = hold_table(cases.study())
    free, gated = row(table, "asrukf", "mu"), row(table, "sb-asrukf", "mu")
    # Seeds: 6, 12 and 18 N m s/rad beyond the truth of 0.1.
    assert free["Largest / truth, min"] == pytest.approx(60.9, abs=0.1)
    assert free["Largest / truth, max"] == pytest.approx(180.9, abs=0.1)
    assert free["Adapted"] == 100.0
    assert gated["Adapted"] == pytest.approx(100 / 61)  # the last of 61 points is the end of the hold itself
    assert gated["Largest / truth, max"] == pytest.approx(0.5, abs=0.01)
    # The held friction starts alike in all seeds and moves at the last point only, which is the end of the hold.
    at_begin = [cases.estimates("asrukf", seed)[cases.AT >= 9.0, 1][0] / 0.1 for seed in range(3)]
    assert free["Spread / truth"] == pytest.approx(np.std(at_begin, ddof=1))
    assert free["Moved less"] == "0 / 3"
    mass = [cases.estimates("asrukf", seed)[(cases.AT >= 9.0) & (cases.AT <= 12.0), 2] for seed in range(3)]
    spread = np.std([m[0] for m in mass], ddof=1)
    less = sum(np.ptp(m) < spread for m in mass)
    assert row(table, "asrukf", "m")["Moved less"] == f"{less} / 3"
    assert less > 0
    assert gated["Settled after the hold"] == first_point_after(1.6094)
    assert hold_table(cases.study(held=None)) is None
    assert hold_table(cases.study(held=(30.0, 40.0))) is None  # after the end of the curves


def test_sentences_say_what_the_tables_hold():
    ends = "2 of 2 parameters end within 10% of the truth on average over 3 seeds"
    assert tracking_sentences(cases.study()) == [
        f"asrukf: {ends}; the largest bias is -4.01 %, of mu.",
        "asrukf: of the variances, that of v_q at 10 times its truth on average.",
        "asrukf: while the motion is held, mu reaches 60.9 to 181 times its truth (3 seeds).",
        f"sb-asrukf: {ends}; the largest bias is +3 %, of m.",
        "sb-asrukf: of the variances, that of v_q at 10 times its truth on average.",
        "sb-asrukf: while the motion is held, m reaches 1.02 to 1.04 times its truth (3 seeds).",
    ]
    failed = cases.study([cases.unit("asrukf", status="diverged")])
    assert tracking_sentences(failed) == ["asrukf: none of 1 seeds converged."]
    assert row(tracking_table(failed), "asrukf", "mu")["Bias"] == Missing("No seed converged")
    assert row(hold_table(failed), "asrukf", "mu")["Largest / truth, max"] == Missing("No seed converged")


def test_without_a_truth_no_error_is_made_up():
    bare = cases.study([cases.unit("asrukf", with_truth=False)])
    cells = row(tracking_table(bare), "asrukf", "mu")
    assert cells["Truth"] == Missing("The truth is not known")
    assert all(isinstance(cells[c], Missing) for c in ("Bias", "RMSE", "Settled"))
    assert change_times(online(bare)) == []
    assert tracking_sentences(bare) == []
    assert [p.name for p in online_plots(bare)] == ["unknowns-over-time", "states-over-time"]
    for plot in online_plots(bare):
        assert plot.figure.axes


def test_a_constant_truth_is_taken_from_the_result():
    result = cases.unit("asrukf")
    kept = tuple(s for s in result.estimate.series if s.name not in ("parameters_true", "open"))
    constant = replace(result, estimate=replace(result.estimate, series=kept))
    found = track(constant, "m")
    assert (found.truth == 2.0).all()
    assert found.gate.all()
    assert (track(constant, "v_q").truth == 1e-10).all()  # of the noise's variance
    assert np.isnan(track(replace(constant, Q_true=None), "v_q").truth).all()
    assert track(constant, "none") is None


def test_changes_and_spans():
    assert change_times([cases.unit("asrukf")]) == [8.0]
    at = np.arange(6.0)
    assert spans(np.array([1, 1, 0, 0, 1, 1], bool), at) == [(0.0, 2.0), (4.0, 5.0)]
    assert spans(np.zeros(6, bool), at) == []


def test_other_methods_have_no_such_section():
    other = report_cases.simulated(samples=200)
    assert tracking_table(other) is None
    assert hold_table(other) is None
    assert online_plots(other) == []
    over_tests = cases.unit("asrukf")
    moved = tuple(replace(s, axis=("test", "")) for s in over_tests.estimate.series)
    assert online(cases.study([replace(over_tests, estimate=replace(over_tests.estimate, series=moved))])) == []


def test_figures_hold_the_curves_and_say_what_leaves_them():
    plots = {p.name: p for p in online_plots(cases.study())}
    assert list(plots) == ["unknowns-over-time", "sensitivities-sb-asrukf", "states-over-time"]
    axes = plots["unknowns-over-time"].figure.axes
    mu = axes[1]
    np.testing.assert_array_equal(mu.lines[0].get_ydata(), cases.estimates("asrukf", 0)[:, 1])
    np.testing.assert_array_equal(mu.lines[2].get_ydata(), cases.truth()[:, 1])
    assert mu.get_ylim()[1] < 0.2  # the gated method decides; the other reaches 6
    assert [t.get_text() for t in mu.texts] == [f"↑ {cases.estimates('asrukf', 0)[:, 1].max():.3g}"]
    assert axes[0].get_yscale() == "log"
    sensitivity = plots["sensitivities-sb-asrukf"].figure.axes
    assert [a.get_title(loc="left") for a in sensitivity] == ["q [rad]", "v_q", "mu", "m"]
    states = plots["states-over-time"].figure.axes
    assert [len(a.lines) for a in states] == [3, 3]
    assert "Drawn is replicate-000" in plots["states-over-time"].caption


def test_the_hold_is_shaded_from_its_begin_to_its_end_in_every_panel():
    for plot in online_plots(cases.study()):
        assert "Grey: the motion is held." in plot.caption
        for axis in plot.figure.axes:
            shaded = [p for p in axis.patches if not p.get_hatch()]  # hatched: not adapted
            assert [(p.get_x(), p.get_x() + p.get_width()) for p in shaded] == [pytest.approx(cases.HOLD)]
    for plot in online_plots(cases.study(held=None)):
        assert "Grey" not in plot.caption
        assert all(p.get_hatch() for axis in plot.figure.axes for p in axis.patches)


def test_the_report_holds_them_and_the_terminal_the_tables(tmp_path):
    made = make_report(cases.study(), tmp_path, ("html", "csv", "svg"))
    page = made.html.read_text()
    assert "How did the estimates move over time?" in page
    assert {"tracking.csv", "hold.csv"} <= {p.name for p in made.tables}
    assert {"unknowns-over-time.svg", "states-over-time.svg"} <= {p.name for p in made.figures}
    assert {"tracking", "hold"} <= {t.name for t in terminal_tables(cases.study())}

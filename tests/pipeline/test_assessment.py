"""What is made of an estimate: held-out ends, today's tuning, standard errors by score and by bootstrap."""

import numpy as np
import pytest

from noiseid_cli.errors import DataError
from noiseid_cli.pipeline.assessment import fitted_part
from noiseid_cli.pipeline.context import open_experiment
from noiseid_cli.pipeline.datasets import make_dataset
from noiseid_cli.pipeline.diagnosing import diagnose_experiment, diagnose_result
from noiseid_cli.pipeline.estimation import make_estimate
from noiseid_cli.pipeline.units import dataset_units, estimate_units
from noiseid_cli.storage.dataset_file import read_dataset
from noiseid_cli.storage.result_file import read_result

ONE = ("estimate.starts.scale=[1]", "simulate.samples=400")


def made(small, tmp_path, *overrides):
    """The first result of the small experiment with these settings, and what it was made from."""
    context = open_experiment(small, tmp_path / "runs", (*ONE, *overrides))
    data = dataset_units(context)[0]
    if not data.done:
        make_dataset(context, data)
    unit = estimate_units(context)[0]
    return make_estimate(context, unit), context, unit


def test_a_method_does_not_see_what_is_held_out(small, tmp_path):
    """The rest may be anything: an experiment that ends where the held-out part begins gives the same estimate."""
    result, context, unit = made(small, tmp_path, "estimate.holdout.last=0.3")
    dataset = read_dataset(unit.dataset.path)
    fitted = fitted_part(context.experiment.estimate, dataset)
    assert [r.samples for r in fitted.recordings] == [280]
    assert len(result.evaluations["estimate"].nis_time) == 280
    assert len(result.held_out["estimate"].nis_time) == 120
    assert result.held_out_tests == 1
    whole, _, _ = made(small, tmp_path)
    assert whole.held_out == {}
    # The log-likelihood of the parts at the same values adds up to that of the whole.
    parts = result.evaluations["start"].loglik + result.held_out["start"].loglik
    assert parts == pytest.approx(whole.evaluations["start"].loglik, rel=1e-12)
    assert "the last 30 % of each test were held out" in fitted.notes[-1]


def test_the_tuning_in_use_is_set_beside_the_estimate(small, tmp_path):
    tuning = "estimate.tuning={process_noise: {std: [3]}, measurement_noise: {std: [2e-3]}}"
    result, _, _ = made(small, tmp_path, tuning, "estimate.holdout.last=0.25")
    assert list(result.evaluations) == ["tuning", "start", "estimate", "truth"]
    assert list(result.held_out) == ["tuning", "start", "estimate", "truth"]
    np.testing.assert_allclose(result.Q_tuning, [[9.0]])
    np.testing.assert_allclose(result.R_tuning, [[4e-6]])
    # No method starts from it.
    assert result.estimate.start.Q[0, 0] == pytest.approx(1.0)
    assert result.evaluations["tuning"].loglik < result.evaluations["estimate"].loglik


def test_standard_errors_by_score_and_bootstrap_agree(small, tmp_path):
    """40 replicates know a standard error to 1 / sqrt(80) = 11 %; four of those, and the score's own error."""
    score, _, _ = made(small, tmp_path)
    boot, _, unit = made(small, tmp_path, "estimate.uncertainty={method: bootstrap, replicates: 40, level: 0.8}")
    again, _, _ = made(small, tmp_path, "estimate.uncertainty={method: bootstrap, replicates: 40, level: 0.8}")
    assert score.uncertainty is not None
    assert boot.uncertainty is not None
    assert boot.uncertainty.names == score.uncertainty.names == (("process_noise_std", "v", "N"),)
    ratio = boot.uncertainty.standard_errors[0] / score.uncertainty.standard_errors[0]
    assert abs(np.log(ratio)) < 4 / np.sqrt(80) + 0.1
    assert (boot.uncertainty.method, boot.uncertainty.level) == ("bootstrap", 0.8)
    assert boot.uncertainty.lower[0] < boot.uncertainty.upper[0]
    # 80 % intervals are narrower than 95 %, by 1.28 / 1.96 on the log scale if normal.
    widths = [np.log(u.upper[0] / u.lower[0]) for u in (boot.uncertainty, score.uncertainty)]
    assert widths[0] < widths[1]
    assert np.array_equal(again.uncertainty.standard_errors, boot.uncertainty.standard_errors)
    assert read_result(unit.path).uncertainty.names == boot.uncertainty.names


ML = ("estimate.methods={ml: {}}", "estimate.parameters={k: {start: 39, lower: 0}}")


def test_errors_of_noise_and_parameters_by_likelihood_and_bootstrap_agree(small, tmp_path):
    """16 replicates know a standard error to 1 / sqrt(32) = 18 %; three of those."""
    ours, _, unit = made(small, tmp_path, *ML)
    boot, _, _ = made(small, tmp_path, *ML, "estimate.uncertainty={method: bootstrap, replicates: 16}")
    expected = (("process_noise_std", "v", "N"), ("parameter", "k", "N/m"))
    assert ours.uncertainty.names == boot.uncertainty.names == expected
    ratio = boot.uncertainty.standard_errors / ours.uncertainty.standard_errors
    assert np.all(np.abs(np.log(ratio)) < 3 / np.sqrt(32) + 0.1)
    found = ours.estimate.parameters
    assert ours.uncertainty.standard_errors[1] == found.standard_errors[0]
    # What cannot be negative has its interval on the logarithm.
    assert (ours.uncertainty.lower[1], ours.uncertainty.upper[1]) == pytest.approx(found.interval(0))
    assert found.log_scale == (True,)
    assert not ours.uncertainty.remarks
    assert read_result(unit.path).uncertainty.names == expected
    rows = [row for row in _certainty_and_parameters(ours) if row[1:3] == ("parameter_standard_error", "k")]
    assert len(rows) == 1


def _certainty_and_parameters(result):
    from noiseid_cli.report.tidy import _certainty_rows, _parameter_rows

    return [*_certainty_rows(result), *_parameter_rows(result)]


def test_a_parameter_without_an_error_is_held_and_named(small, tmp_path):
    """A bound far off the truth: the parameter runs to it, and the noise is judged as if it were known."""
    result, _, _ = made(small, tmp_path, ML[0], "estimate.parameters={k: {start: 61, lower: 60}, d: {start: 1}}")
    assert any("k has run to its lower bound" in text for text in result.estimate.safeguards)
    u = result.uncertainty
    assert "The standard errors of the noise hold k." in u.remarks
    k, d = u.index("parameter", "k"), u.index("parameter", "d")
    assert (np.isnan(u.standard_errors[k]), u.upper[k]) == (True, np.inf)
    assert "at a bound" in u.notes[k]
    assert np.isfinite(u.standard_errors[[0, d]]).all()


def test_parameters_alone_have_intervals_too(small, tmp_path):
    known = "estimate.process_noise={known: {std: [0.5]}}"
    result, _, _ = made(small, tmp_path, *ML, known, "estimate.uncertainty.level=0.5")
    assert result.uncertainty.names == (("parameter", "k", "N/m"),)
    assert np.log(result.uncertainty.upper / result.uncertainty.lower)[0] == pytest.approx(
        2 * 0.6744898 * result.uncertainty.standard_errors[0] / result.uncertainty.values[0]
    )


def test_no_standard_errors_where_none_are_asked_for_or_the_curvature_means_nothing(small, tmp_path):
    assert made(small, tmp_path, "estimate.uncertainty.method=none")[0].uncertainty is None
    result, _, _ = made(small, tmp_path, "estimate.methods={alg3: {}}")
    assert result.uncertainty is None
    assert any(text.startswith("no standard errors: alg3 does not maximise") for text in result.estimate.safeguards)


def test_diagnosis_of_an_experiment_before_and_after_and_of_a_file(small, tmp_path):
    context = open_experiment(small, tmp_path / "runs", ONE)
    with pytest.raises(DataError, match="run `noiseid simulate` first"):
        diagnose_experiment(context)
    make_dataset(context, dataset_units(context)[0])
    before = diagnose_experiment(context)
    assert before.at == "start"
    assert [row[2] for row in before.tables[0].rows] == ["start", "truth"]
    result, context, unit = made(small, tmp_path)
    after = diagnose_experiment(context)
    assert after.at == "estimate"
    assert [table.name for table in after.tables] == ["agreement", "innovations-estimate", "where-estimate"]
    assert {row[1] for row in after.tables[2].rows} == {"time", "x", "w", "f"}
    same = diagnose_result(unit.path)
    assert same.tables[0].rows == after.tables[0].rows
    assert diagnose_result(unit.path, "truth").at == "truth"
    with pytest.raises(DataError, match="no filter was run at the tuning values; there are: estimate, start, truth"):
        diagnose_result(unit.path, "tuning")
    assert result.evaluations["truth"].nees == pytest.approx(1, abs=0.5)


def test_standard_errors_of_ml_are_marginal_over_the_parameters(small, tmp_path):
    """On a linear model they are em's where nothing else is unknown, and greater where a parameter is."""
    em, _, _ = made(small, tmp_path)
    ml, _, _ = made(small, tmp_path, "estimate.methods={ml: {}}")
    np.testing.assert_allclose(ml.uncertainty.values, em.uncertainty.values, rtol=1e-3)
    np.testing.assert_allclose(ml.uncertainty.standard_errors, em.uncertainty.standard_errors, rtol=5e-3)
    parameters = "estimate.parameters={k: {start: 39, lower: 0}, m: {start: 0.6, lower: 0}}"
    both, _, _ = made(small, tmp_path, "estimate.methods={ml: {}}", parameters)
    assert both.uncertainty.names[:1] == ml.uncertainty.names
    relative = [u.standard_errors[0] / u.values[0] for u in (both.uncertainty, ml.uncertainty)]
    assert relative[0] > 1.02 * relative[1]
    assert not any("hold" in remark for remark in both.uncertainty.remarks)
    bound = "estimate.parameters={k: {start: 39, lower: 0}, d: {start: 1.5, lower: 1.4}}"
    held, _, _ = made(small, tmp_path, "estimate.methods={ml: {}}", bound, "model.parameters={d: 0.2}")
    assert "The standard errors of the noise hold d." in held.uncertainty.remarks


def test_where_the_likelihood_is_jagged_the_errors_are_the_smoothers(small, tmp_path, monkeypatch):
    """An exact gradient that jumps says nothing of the curvature: the score takes its place, and that is said."""
    from noiseid_cli.estimators import observed_information

    plain, _, _ = made(small, tmp_path, "estimate.methods={ml: {}}")
    monkeypatch.setattr(observed_information, "marginal_information", lambda *a: np.array([[-1e4]]))
    found, _, _ = made(small, tmp_path, "estimate.methods={ml: {}}")
    np.testing.assert_allclose(found.uncertainty.standard_errors, plain.uncertainty.standard_errors, rtol=5e-3)
    assert "it is jagged there" in found.uncertainty.remarks[-1]
    assert not any("jagged" in remark for remark in plain.uncertainty.remarks)

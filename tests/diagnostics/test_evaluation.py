"""The true filter is consistent; misfit is found where it is; held-out scores are exact."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dense_gaussian import dense_posterior
from random_models import random_case
from scipy.stats import jarque_bera

from noiseid_cli.diagnostics.consistency import consistency
from noiseid_cli.diagnostics.evaluate import evaluate
from noiseid_cli.diagnostics.misfit import held_out_sentences, misfit_sentences
from noiseid_cli.diagnostics.where import misfits
from noiseid_cli.estimators import em
from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.estimators.unknowns import Unknowns
from noiseid_cli.filters.ekf import extended_kalman_filter
from noiseid_cli.models.compile import compile_model
from noiseid_cli.models.linear import linear_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording, head
from noiseid_cli.models.registry import load_model_file

ROOT = Path(__file__).parents[2]


def simulated(seed, tests, samples):
    """A random linear model with ``tests`` independent recordings and their true states."""
    case = random_case(seed, 3, 2, 2, lengths=(2,) * tests)
    rng = np.random.default_rng(seed)
    n, recordings = case.noise, []
    for i in range(tests):
        x = rng.multivariate_normal(n.m0[i], n.P0)
        u, xs, y = rng.normal(size=(samples, 1)), np.empty((samples, 3)), np.empty((samples, 2))
        for k in range(samples):
            xs[k] = x
            y[k] = case.C @ x + case.D @ u[k] + rng.multivariate_normal(np.zeros(2), n.R)
            x = case.A @ x + case.B @ u[k] + case.G @ rng.multivariate_normal(np.zeros(2), n.Q)
        recordings.append(Recording(f"t{i}", np.ones(samples - 1), u, y, x_true=xs))
    return case, recordings


def test_nees_of_the_true_filter_is_chi_square():
    """One sample of each of 300 independent tests: 900 squared standard normals, 300 trials of the bounds."""
    case, recordings = simulated(3, 300, 6)
    found = evaluate(case.model, recordings, case.noise, "truth", first=[5] * 300)
    assert found.nees_time is not None
    assert len(found.nees_time) == 300
    assert abs(found.nees - 1) < 4 * np.sqrt(2 / 900)
    assert abs(found.nees_inside() - 0.95) < 4 * np.sqrt(0.95 * 0.05 / 300)
    small = evaluate(case.model, recordings, replace(case.noise, Q=case.noise.Q / 100, R=case.noise.R / 100), "start")
    assert small.nees > 5
    assert small.nees_inside() < 0.5


def test_nees_does_not_depend_on_units_and_is_open_where_a_state_is_known():
    case, recordings = simulated(4, 2, 8)
    known = replace(case.noise, P0=np.zeros((3, 3)))
    found = evaluate(case.model, recordings, known, "truth")
    assert found.nees_time is not None
    assert np.isnan(found.nees_time[[0, 8]]).all()
    assert np.isfinite(found.nees_time[[4, 12]]).all()


def test_true_filter_is_white_within_its_bounds_and_in_its_bands():
    case, recordings = simulated(5, 1, 3000)
    found = evaluate(case.model, recordings, case.noise, "truth")
    low, high = found.nis_bounds(0.9999)
    assert low < found.nis < high
    assert np.all(found.ljung_box > 1e-3)
    assert found.inside is not None
    assert np.all(np.abs(found.inside - 0.95) < 4 * np.sqrt(0.95 * 0.05 / 3000))
    assert not misfit_sentences(found, ["y1", "y2"], None)[1:]
    # Tighter bounds lie inside wider ones, and narrow as 1 / sqrt(observed).
    assert found.nis_bounds(0.5)[0] > low
    assert found.nis_bounds()[1] - 1 == pytest.approx(1.96 * np.sqrt(2 / found.observed), rel=0.05)


def test_held_out_loglik_is_that_of_the_rest_given_the_fitted_part():
    case = random_case(7, 2, 1, 2, lengths=(14, 9), missing=0.2)
    found = evaluate(case.model, case.recordings, case.noise, "estimate", first=[9, 5])
    n = case.noise

    def dense(recording, i):
        return dense_posterior(case.A, case.B, case.G, case.C, case.D, recording, n.Q, n.R, n.m0[i], n.P0)[2]

    exact = sum(
        dense(r, i) - dense(head(r, k), i) for i, (r, k) in enumerate(zip(case.recordings, (9, 5), strict=True))
    )
    assert found.loglik == pytest.approx(exact, abs=1e-9)
    assert len(found.nis_time) == 5 + 4
    assert found.observed == sum(np.isfinite(r.y[k:]).sum() for r, k in zip(case.recordings, (9, 5), strict=True))


def test_normality_is_the_test_of_jarque_and_bera():
    rng = np.random.default_rng(1)
    nu = np.column_stack([rng.normal(size=400), rng.exponential(size=400)])
    nu[7, 0] = np.nan
    found = consistency("a", [nu], [np.broadcast_to(np.eye(2), (400, 2, 2))], 0.0)
    assert found.normality is not None
    expected = [jarque_bera(nu[np.isfinite(nu[:, 0]), 0]).pvalue, jarque_bera(nu[:, 1]).pvalue]
    np.testing.assert_allclose(found.normality, expected, rtol=1e-9)


def test_misfit_is_found_against_the_quantity_that_makes_it():
    """Measurement noise that grows with the input: the NIS follows |u|, not the state and not time."""
    rng = np.random.default_rng(2)
    N = 4000
    model = linear_model(A=[[0.9]], G=[[1.0]], C=[[1.0]], B=[[0.0]])
    u = rng.uniform(-1, 1, size=(N, 1))
    x = np.zeros(N)
    for k in range(1, N):
        x[k] = 0.9 * x[k - 1] + rng.normal()
    y = (x + np.where(np.abs(u[:, 0]) > 0.6, 6.0, 1.0) * rng.normal(size=N))[:, None]
    recording = Recording("loud", np.ones(N - 1), u, y)
    noise = NoiseValues(np.eye(1), np.eye(1), np.zeros((1, 1)), np.eye(1))
    found = evaluate(model, [recording], noise, "estimate")
    by_name = {misfit.name: misfit for misfit in found.misfit}
    assert set(by_name) == {"time", "x1", "u1"}
    loud = by_name["u1"]
    assert loud.unevenness > 0.5 > 2 * by_name["time"].unevenness
    assert min(abs(edge) for edge in loud.worst()[:2]) > 0.5
    assert loud.counts.sum() == found.observed
    assert float(loud.counts @ loud.nis) / found.observed == pytest.approx(found.nis, rel=1e-9)
    text = " ".join(misfit_sentences(found, ["y1"], 1.0))
    assert "The misfit follows u1" in text
    assert "standing in" not in text
    assert "stands in for model error" in text


def test_what_hardly_moves_or_was_not_measured_has_no_misfit():
    model = linear_model(A=[[0.9]], G=[[1.0]], C=[[1.0]], B=[[0.0]])
    recording = Recording("still", np.ones(19), np.zeros((20, 1)), np.ones((20, 1)))
    noise = NoiseValues(np.eye(1), np.eye(1), np.zeros((1, 1)), np.eye(1))
    filtered = extended_kalman_filter(model, recording, noise)
    names = [m.name for m in misfits(model, [recording], [filtered], [0], np.ones(20), np.ones(20))]
    assert "u1" not in names
    assert misfits(model, [recording], [filtered], [0], np.full(20, np.nan), np.zeros(20)) == ()


def test_held_out_sentences_say_whether_the_estimate_carries_over():
    rng = np.random.default_rng(3)

    def of(label, scale, loglik):
        S = np.broadcast_to(np.eye(1), (500, 1, 1))
        nu = rng.normal(size=(500, 1))
        return consistency(label, [scale * nu / np.sqrt(np.mean(nu**2))], [S], loglik)

    fitted = of("estimate", 1.0, 10.0)
    good = held_out_sentences(fitted, {"tuning": of("tuning", 1, 3.0), "estimate": of("estimate", 1.0, 8.0)})
    assert "inside its bounds" in good[0]
    assert "5 higher than that of the covariances in use" in good[1]
    bad = held_out_sentences(fitted, {"start": of("start", 1, 9.0), "estimate": of("estimate", 1.5, 8.0)})
    assert "outside its bounds" in bad[0]
    assert "lower than that of the start values" in bad[1]
    assert "does not carry over" in bad[2]
    assert held_out_sentences(fitted, {}) == []


def double_pendulum(friction):
    """EM on 4 s of the measured double pendulum, with or without the friction of its joints."""
    off = None if friction else dict.fromkeys(("b1", "b2", "c1", "c2"), 0.0)
    model = compile_model(load_model_file(ROOT / "configs" / "double_pendulum.py", "DoublePendulum", off))
    table = np.genfromtxt(ROOT / "data" / "measured" / "double_pendulum_excited.csv", delimiter=",", names=True)
    u, y = (np.column_stack([table[f"{name}{i}"] for i in (1, 2)]) for name in ("tau_meas", "pos_meas"))
    recording = head(Recording("excited", np.diff(table["time"]), u, y), 2000)
    start = NoiseValues(np.eye(2), 1.5e-7 * np.eye(2), np.zeros((1, 4)), np.diag([1e-6, 1e-6, 0.01, 0.01]))
    unknowns = Unknowns(Q=CovarianceStructure.full(start.Q), R=CovarianceStructure.diagonal(start.R))
    end = em.estimate(model, [recording], start, unknowns, em.EmOptions(linearisation="filtered"))
    return evaluate(model, [recording], end.final, "estimate")


def test_a_pendulum_without_its_friction_is_called_wrong():
    """NIS is 1 either way. Left-out friction shows as a correlation that does not die out, and costs likelihood."""
    right, wrong = double_pendulum(True), double_pendulum(False)
    slow = "a slow error of the model, such as friction left out"
    for found in (right, wrong):
        assert found.nis == pytest.approx(1, abs=0.01)
    said = misfit_sentences(wrong, ["q1", "q2"], 0.002)
    assert any(text.startswith("q2: the correlation does not die out") and slow in text for text in said)
    assert "stands in for model error" in said[-1]
    assert not any(slow in text for text in misfit_sentences(right, ["q1", "q2"], 0.002))
    assert right.loglik > wrong.loglik + 100

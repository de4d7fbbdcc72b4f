"""Alg. 3 against a slow twin, its relation to EM, its stops and what it refuses."""

import numpy as np
import pytest
from covariance_form import filter_twin, smoother_twin, step
from dense_gaussian import dense_posterior
from pendulum import pendulum_case
from random_models import random_case, random_covariance

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators import alg3, em
from noiseid_cli.estimators.alg3 import Alg3Options, smoothed_noise
from noiseid_cli.estimators.em_statistics import e_step
from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.estimators.unknowns import Unknowns
from noiseid_cli.filters.ekf import FilterDivergedError
from noiseid_cli.filters.smoother import filter_to_smooth
from noiseid_cli.models.linear import linear_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording


def unknown(Q, kind="full"):
    return Unknowns(Q=getattr(CovarianceStructure, kind)(Q, "Q"))


def with_Q(noise, Q):
    return NoiseValues(Q, noise.R, noise.m0, noise.P0)


def random_walk(N=200, q=1.0, r=1.0, seed=0, dimension=1):
    """A random walk of std q per step, seen with std r."""
    rng = np.random.default_rng(seed)
    x = np.cumsum(q * rng.normal(size=(N, dimension)), axis=0)
    recording = Recording("walk", np.ones(N - 1), np.zeros((N, 0)), x + r * rng.normal(size=(N, dimension)))
    unit = np.eye(dimension)
    return linear_model(unit, unit, unit), recording, NoiseValues(q**2 * unit, r**2 * unit, x[:1], unit)


def noise_twin(model, recordings, noise):
    """All v_k by the textbook smoother and numpy's pseudo-inverse."""
    out = []
    for i, r in enumerate(recordings):
        m, _, _ = smoother_twin(filter_twin(model, r, noise, i))
        for k in range(r.samples - 1):
            x_next, _, F2 = step(model, m[k], r.u[k], r.dt[k])
            out.append(np.linalg.pinv(F2) @ (m[k + 1] - x_next))
    return np.array(out)


@pytest.mark.parametrize("kind", ["full", "diagonal", "blocks", "scaled"])
def test_equals_a_slow_twin(kind):
    """Five steps over two tests of different length with missing outputs."""
    case = random_case(3, 4, 3, 4, lengths=(40, 25), missing=0.1)
    case.noise.R[:] *= 0.05
    Q = np.diag([2.0, 0.5, 1.0])
    unknowns = Unknowns(Q=CovarianceStructure(Q, ((0, 2), (1,)), what="Q")) if kind == "blocks" else unknown(Q, kind)
    result = alg3.estimate(
        case.model, case.recordings, with_Q(case.noise, Q), unknowns, Alg3Options(max_passes=5, parameter_tolerance=0.0)
    )
    keep = {"full": np.ones((3, 3)), "diagonal": np.eye(3), "blocks": np.array([[1, 0, 1], [0, 1, 0], [1, 0, 1]])}
    assert result.passes == 5
    expected = Q
    for k in range(5):
        assert np.allclose(result.trace["Q"][k], expected, rtol=1e-8, atol=1e-10)
        sample = np.cov(noise_twin(case.model, case.recordings, with_Q(case.noise, expected)).T, ddof=1)
        expected = Q * np.mean(np.diag(sample) / np.diag(Q)) if kind == "scaled" else sample * keep[kind]
    assert np.array_equal(result.final.Q, result.trace["Q"][-1])


def test_equals_a_slow_twin_on_a_nonlinear_model():
    model, noise, recordings = pendulum_case(4, lengths=(60, 30), missing=0.1)
    v, loglik, singular = smoothed_noise(model, recordings, noise)
    assert np.allclose(v, noise_twin(model, recordings, noise), rtol=1e-8, atol=1e-9)
    assert loglik == e_step(model, recordings, noise).loglik
    assert singular == 0


@pytest.mark.parametrize("seed", range(5))
def test_what_it_leaves_out_is_the_smoothed_covariance(seed):
    """EM's moment less the second moment of the smoothed noise is the mean posterior covariance of v."""
    case = random_case(seed, 3, 2, 2, lengths=(12, 9), missing=0.2)
    noise, n, nv = case.noise, 3, 2
    left_out, steps = np.zeros((nv, nv)), 0
    for i, r in enumerate(case.recordings):
        _, cov, _ = dense_posterior(case.A, case.B, case.G, case.C, case.D, r, noise.Q, noise.R, noise.m0[i], noise.P0)
        for k in range(r.samples - 1):
            at = slice(r.samples * n + k * nv, r.samples * n + (k + 1) * nv)
            left_out += cov[at, at]
            steps += 1
    v, _, _ = smoothed_noise(case.model, case.recordings, noise)
    moment = e_step(case.model, case.recordings, noise).moment_v
    assert np.allclose(moment - v.T @ v / steps, left_out / steps, rtol=1e-9, atol=1e-11)


def test_it_under_estimates_and_em_does_not():
    """Where a fixed point above zero exists, it is one from all starts, and below EM's."""
    model, recording, noise = random_walk(2000, q=1.0, r=0.2)
    ends = []
    for factor in (0.5, 100.0):
        start = with_Q(noise, noise.Q * factor)
        result = alg3.estimate(model, [recording], start, unknown(start.Q), Alg3Options(parameter_tolerance=1e-8))
        assert result.status == "converged"
        ends.append(result.final.Q[0, 0])
    by_em = em.estimate(model, [recording], noise, unknown(noise.Q)).final.Q[0, 0]
    # The spread of an estimated variance is sqrt(2/N); EM within three of it, Alg. 3 below by far more.
    spread = np.sqrt(2 / 2000)
    assert abs(by_em - 1.0) < 3 * spread * 1.2
    assert np.isclose(ends[0], ends[1], rtol=1e-6)
    assert ends[0] < by_em - spread


def test_a_noise_that_is_hardly_seen_runs_to_zero_and_is_said_to():
    model, recording, noise = random_walk(200, q=0.3, r=1.0)
    result = alg3.estimate(model, [recording], noise, unknown(noise.Q))
    assert result.status == "stalled_fixed_point"
    assert "the standard deviation of noise 1 is" in result.reason
    assert 0.0 < result.final.Q[0, 0] < 0.01 * noise.Q[0, 0]
    assert "shrinks towards zero" in result.safeguards[0]
    assert result.loglik == result.trace["loglik"][-1] < result.loglik_start
    sooner = alg3.estimate(model, [recording], noise, unknown(noise.Q), Alg3Options(zero_tolerance=0.1))
    assert sooner.status == "stalled_fixed_point"
    assert sooner.passes < result.passes
    assert np.array_equal(sooner.trace["Q"], result.trace["Q"][: sooner.passes])


def test_a_direction_that_is_not_seen_at_all_is_named():
    """Only the sum of two walks is measured: the smoothed noises are all on one line."""
    _, recording, noise = random_walk(50, dimension=2)
    model = linear_model(np.eye(2), np.eye(2), [[1.0, 1.0]])
    seen = Recording("sum", recording.dt, recording.u, recording.y.sum(axis=1, keepdims=True))
    start = NoiseValues(noise.Q, np.eye(1), noise.m0, noise.P0)
    result = alg3.estimate(model, [seen], start, unknown(start.Q))
    assert (result.status, result.passes) == ("stalled_fixed_point", 1)
    assert "smallest eigenvalue of the correlations" in result.reason
    assert np.array_equal(result.final.Q, start.Q)


@pytest.mark.parametrize(
    ("options", "status"),
    [({"max_passes": 3, "parameter_tolerance": 0.0}, "max_passes"), ({"parameter_tolerance": 0.05}, "converged")],
)
def test_stop_rules_progress_and_trace(options, status):
    case = random_case(5, 3, 2, 3, lengths=(300,), missing=0.0)
    case.noise.R[:] *= 1e-3
    start = with_Q(case.noise, random_covariance(np.random.default_rng(1), 2))
    seen = []
    result = alg3.estimate(
        case.model, case.recordings, start, unknown(start.Q), Alg3Options(**options), lambda k, ll: seen.append((k, ll))
    )
    assert result.status == status
    assert result.method == "alg3"
    assert seen == list(enumerate(result.trace["loglik"].tolist(), 1))
    assert {name: len(values) for name, values in result.trace.items()} == dict.fromkeys(
        ("loglik", "Q", "R", "change", "extrapolated", "accepted"), result.passes
    )
    assert result.settings == {"max_passes": 500, "parameter_tolerance": 1e-5, "zero_tolerance": 1e-6} | options
    if status == "converged":
        assert result.trace["change"][-1] <= 0.05 < result.trace["change"][-2]
    assert result.final.R is start.R
    assert np.all(result.trace["R"] == start.R)


def test_singular_predictions_are_counted():
    case = random_case(6, 3, 1, 3, lengths=(200,), missing=0.0)
    case.noise.R[:] *= 1e-3
    start = NoiseValues(case.noise.Q, case.noise.R, case.noise.m0, np.zeros((3, 3)))
    result = alg3.estimate(case.model, case.recordings, start, unknown(start.Q), Alg3Options(max_passes=1))
    assert result.safeguards == ("2 predicted covariances were singular (a state was exactly known)",)


def test_divergence_at_the_start_and_later(monkeypatch):
    model, recording, noise = random_walk(50, r=0.1)
    runs = []

    def failing(*args):
        runs.append(args)
        if len(runs) == fails_at:
            raise FilterDivergedError(1, 3, recording)
        return filter_to_smooth(*args)

    monkeypatch.setattr(alg3, "filter_to_smooth", failing)
    fails_at = 3
    result = alg3.estimate(model, [recording], with_Q(noise, noise.Q * 50), unknown(noise.Q * 50))
    assert (result.status, result.passes) == ("diverged", 2)
    assert "after 2 passes test 'walk'" in result.reason
    assert np.array_equal(result.final.Q, result.trace["Q"][1])
    runs.clear()
    fails_at = 1
    with pytest.raises(FilterDivergedError):
        alg3.estimate(model, [recording], noise, unknown(noise.Q))


@pytest.mark.parametrize(
    ("unknowns", "text"),
    [
        (Unknowns(), "nothing is unknown"),
        (Unknowns(R=CovarianceStructure.full(np.eye(1))), "give measurement_noise as known, or use em"),
        (Unknowns(Q=CovarianceStructure.full(np.eye(1)), m0=True), "give initial_mean as known"),
        (Unknowns(P0=CovarianceStructure.full(np.eye(1))), "give initial_covariance as known"),
        (unknown(np.zeros((1, 1))), "start of Q has zero variance"),
    ],
)
def test_problems_without_an_answer_are_refused(unknowns, text):
    model, recording, noise = random_walk(20)
    with pytest.raises(EstimationError, match=text):
        alg3.estimate(model, [recording], noise, unknowns)


def test_too_few_steps_and_dependent_gains_are_refused():
    model, recording, noise = random_walk(2)
    with pytest.raises(EstimationError, match="1 steps give no regular sample covariance of 1 noises"):
        alg3.estimate(model, [recording], noise, unknown(noise.Q))
    for gain in ([[1.0, 2.0]], [[1.0], [0.0]]):
        n, nv = np.shape(gain)
        model = linear_model(0.5 * np.eye(n), np.array(gain) * (n == 1), np.ones((1, n)))
        recording = Recording("run", np.ones(3), np.zeros((4, 0)), np.ones((4, 1)))
        noise = NoiseValues(np.eye(nv), np.eye(1), np.zeros((1, n)), np.eye(n))
        with pytest.raises(EstimationError, match="'run', sample 1: the columns of the noise gain F2 are linearly"):
            alg3.estimate(model, [recording], noise, unknown(noise.Q))

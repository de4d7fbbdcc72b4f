"""Alg. 2 against a search by brute force and a slow twin, its stops, its box and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest
from covariance_form import filter_twin

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators import alg2, path_search
from noiseid_cli.estimators.alg2 import Alg2Options
from noiseid_cli.filters.ekf import FilterDivergedError, extended_kalman_filter
from noiseid_cli.filters.path_error import path_error
from noiseid_cli.models.linear import linear_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording

BOTH = pytest.mark.parametrize("optimiser", ["least_squares", "nelder_mead"])


def tracking_case(seed=0, lengths=(150, 100), q=(0.5, 0.1), r=0.4):
    """Two coupled states with a noise each, both measured; what is measured is to be estimated."""
    A, rng = np.array([[0.9, 0.3], [-0.2, 0.8]]), np.random.default_rng(seed)
    model = linear_model(A, np.eye(2), np.eye(2))
    model = replace(model, performances=("z1", "z2"), performance=model.output, units={"z1": "m", "z2": "m"})
    recordings = []
    for i, N in enumerate(lengths):
        x = np.zeros((N, 2))
        for k in range(N - 1):
            x[k + 1] = A @ x[k] + q * rng.normal(size=2)
        y = x + r * rng.normal(size=(N, 2))
        recordings.append(Recording(f"test-{i}", np.ones(N - 1), np.zeros((N, 0)), y, z_true=x))
    noise = NoiseValues(np.diag(np.square(q)), r**2 * np.eye(2), np.zeros((len(lengths), 2)), 0.01 * np.eye(2))
    return model, recordings, noise


def objective(model, recordings, noise):
    """The objective by the textbook filter and loops."""
    total = 0.0
    for i, r in enumerate(recordings):
        for m, z in zip(filter_twin(model, r, noise, i).m_filt, r.z_true, strict=True):
            total += np.sum((m - z) ** 2)
    return np.sqrt(total)


def scaled(noise, *factors):
    return NoiseValues(noise.Q * np.diag(factors), noise.R, noise.m0, noise.P0)


@BOTH
def test_finds_what_brute_force_finds(optimiser):
    """One noise of unknown variance: the end is the lowest point of a fine grid, to the grid's width."""
    model, recordings, _ = tracking_case()
    model = replace(linear_model([[0.9]], [[1.0]], [[1.0]]), performances=("z1",), performance=model.output)
    recordings = [replace(r, y=r.y[:, :1].copy(), z_true=r.z_true[:, :1].copy()) for r in recordings]
    start = NoiseValues(np.array([[5.0]]), np.array([[0.16]]), np.zeros((2, 1)), np.eye(1))
    grid = np.linspace(np.log(1e-4), np.log(1e4), 1000)
    values = [
        np.linalg.norm(np.concatenate([
            path_error(model, r, extended_kalman_filter(model, r, scaled(start, np.exp(x)), i).m_filt)
            for i, r in enumerate(recordings)
        ]))
        for x in grid
    ]  # fmt: skip
    result = alg2.estimate(model, recordings, start, Alg2Options(optimiser=optimiser))
    assert result.status == "converged"
    assert result.trace["objective"].min() <= min(values)
    assert abs(np.log(result.final.Q[0, 0] / 5.0) - grid[np.argmin(values)]) <= grid[1] - grid[0]


def test_both_optimisers_end_at_one_minimum_from_all_starts():
    model, recordings, noise = tracking_case()
    ends = [
        alg2.estimate(model, recordings, scaled(noise, *factors), Alg2Options(optimiser=optimiser))
        for optimiser in ("least_squares", "nelder_mead")
        for factors in ((1.0, 1.0), (1e-3, 1e2), (1e3, 1e-2))
    ]
    assert all(e.status == "converged" for e in ends)
    lowest = [e.trace["objective"].min() for e in ends]
    # The objective is flat to second order: a relative 1e-8 of it is 1e-4 or so of a standard deviation.
    assert max(lowest) <= min(lowest) * (1 + 1e-8)
    for e in ends:
        assert np.allclose(np.diag(e.final.Q), np.diag(ends[0].final.Q), rtol=1e-3)
    assert max(e.passes for e in ends[:3]) < min(e.passes for e in ends[3:])


@BOTH
def test_the_path_of_the_search_is_recorded_as_it_was(optimiser):
    """Every run: its Q, the objective and the log-likelihood there (slow twin), and whether it became the best."""
    model, recordings, noise = tracking_case(3, lengths=(40, 25))
    start = scaled(noise, 30.0, 0.1)
    seen = []
    result = alg2.estimate(
        model, recordings, start, Alg2Options(optimiser=optimiser), lambda k, ll: seen.append((k, ll))
    )
    t = result.trace
    assert seen == list(enumerate(t["loglik"].tolist(), 1))
    assert all(len(values) == result.passes for values in t.values())
    assert np.array_equal(t["Q"][0], start.Q)
    for k in range(0, result.passes, 7):
        at = NoiseValues(t["Q"][k], start.R, start.m0, start.P0)
        assert t["objective"][k] == pytest.approx(objective(model, recordings, at), rel=1e-10)
        loglik = sum(filter_twin(model, r, at, i).loglik for i, r in enumerate(recordings))
        assert t["loglik"][k] == pytest.approx(loglik, rel=1e-10)
    best_before = np.minimum.accumulate(t["objective"])
    assert np.array_equal(t["accepted"][1:], (t["objective"][1:] < best_before[:-1]).astype(float))
    assert t["accepted"][0] == 1.0
    best = int(np.argmin(t["objective"]))
    assert np.array_equal(result.final.Q, t["Q"][best])
    assert (result.loglik_start, result.loglik) == (t["loglik"][0], t["loglik"][best])
    step = 0.5 * np.max(np.abs(np.log(np.diag(t["Q"][1]) / np.diag(t["Q"][0]))))
    assert (t["change"][0], t["change"][1]) == (0.0, pytest.approx(step, rel=1e-6))
    assert np.all(t["extrapolated"] == 0.0)
    assert np.all(t["R"] == start.R)
    assert result.final.R is start.R
    assert f"{t['objective'][0]:.6g} m to {t['objective'][best]:.6g} m" in result.reason


@BOTH
def test_budget_and_tolerances(optimiser):
    model, recordings, noise = tracking_case()
    start = scaled(noise, 100.0, 0.01)
    spent = alg2.estimate(model, recordings, start, Alg2Options(optimiser=optimiser, max_passes=9))
    assert (spent.status, spent.passes) == ("max_passes", 9)
    assert spent.trace["objective"].min() < spent.trace["objective"][0]
    fine = alg2.estimate(model, recordings, start, Alg2Options(optimiser=optimiser))
    rough = Alg2Options(optimiser=optimiser, parameter_tolerance=0.1, objective_tolerance=1e-2)
    coarse = alg2.estimate(model, recordings, start, rough)
    assert coarse.status == "converged"
    assert coarse.passes < fine.passes
    assert coarse.settings == {
        "optimiser": optimiser,
        "max_passes": 1000,
        "parameter_tolerance": 0.1,
        "objective_tolerance": 1e-2,
        "lambda_span": 1e8,
    }


@BOTH
@pytest.mark.parametrize("off", ["parameter_tolerance", "objective_tolerance"])
def test_a_tolerance_of_zero_leaves_the_stop_to_the_other(optimiser, off):
    model, recordings, noise = tracking_case()
    result = alg2.estimate(model, recordings, scaled(noise, 9.0, 0.1), Alg2Options(optimiser=optimiser, **{off: 0.0}))
    reference = alg2.estimate(model, recordings, scaled(noise, 9.0, 0.1))
    assert np.allclose(np.diag(result.final.Q), np.diag(reference.final.Q), rtol=1e-3)
    assert optimiser == "nelder_mead" or result.status == "converged"


@BOTH
def test_the_box_is_kept_and_an_end_on_its_edge_is_named(optimiser):
    model, recordings, noise = tracking_case()
    start = scaled(noise, 1e-2, 1.0)
    result = alg2.estimate(model, recordings, start, Alg2Options(optimiser=optimiser, lambda_span=2.0))
    factors = np.diagonal(result.trace["Q"], axis1=1, axis2=2) / np.diag(start.Q)
    assert factors.min() >= 0.5 * (1 - 1e-12)
    assert factors.max() <= 2.0 * (1 + 1e-12)
    assert np.isclose(result.final.Q[0, 0], 2.0 * start.Q[0, 0], rtol=1e-2)
    named = [s for s in result.safeguards if "on the edge of its range" in s]
    assert named[0].startswith("the variance of v1 ended")


def test_a_box_narrower_than_a_difference_is_searched_too():
    model, recordings, noise = tracking_case()
    result = alg2.estimate(model, recordings, scaled(noise, 1e-2, 1.0), Alg2Options(lambda_span=1 + 1e-6))
    assert result.status == "converged"
    assert result.final.Q[0, 0] > result.start.Q[0, 0]


def test_samples_without_truth_do_not_count():
    model, recordings, noise = tracking_case(lengths=(80,))
    truth = recordings[0].z_true.copy()
    truth[10:20, 0] = np.nan
    gap = replace(recordings[0], z_true=truth)
    result = alg2.estimate(model, [gap], noise, Alg2Options(max_passes=1))
    m = extended_kalman_filter(model, gap, noise).m_filt
    error = np.delete(path_error(model, recordings[0], m), np.arange(10, 20))
    assert result.trace["objective"][0] == pytest.approx(np.linalg.norm(error), rel=1e-14)


@BOTH
def test_a_start_without_error_is_the_answer(optimiser):
    model, recordings, noise = tracking_case(lengths=(5,))
    still = replace(recordings[0], y=np.zeros((5, 2)), z_true=np.zeros((5, 2)))
    result = alg2.estimate(model, [still], noise, Alg2Options(optimiser=optimiser))
    assert result.status == "converged"
    assert np.array_equal(result.final.Q, noise.Q)


@BOTH
def test_trial_values_that_make_the_filter_fail_are_rejected_and_counted(optimiser, monkeypatch):
    """The filter is made to fail above 1.1 times the start, where the minimum would be."""
    model, recordings, noise = tracking_case()
    start = scaled(noise, 1e-2, 1.0)

    def failing(model, recording, noise, test):
        if noise.Q[0, 0] > 1.1 * start.Q[0, 0]:
            raise FilterDivergedError(1, 3, recording)
        return extended_kalman_filter(model, recording, noise, test)

    monkeypatch.setattr(path_search, "extended_kalman_filter", failing)
    seen = []
    result = alg2.estimate(
        model, recordings, start, Alg2Options(optimiser=optimiser, max_passes=300), lambda k, _: seen.append(k)
    )
    failed = np.isinf(result.trace["objective"])
    assert failed.any()
    assert np.array_equal(failed, np.isnan(result.trace["loglik"]))
    assert not result.trace["accepted"][failed].any()
    assert seen == (np.flatnonzero(~failed) + 1).tolist()
    assert result.safeguards[0].startswith(f"{failed.sum()} trial values made the filter fail: first, test 'test-0'")
    assert 1.0 < result.final.Q[0, 0] / start.Q[0, 0] <= 1.1
    assert np.isfinite(result.loglik)


def test_slopes_are_taken_backward_where_the_filter_fails_forward(monkeypatch):
    """With every step up in the second variance forbidden, the search still finds its minimum below."""
    model, recordings, noise = tracking_case()
    start = scaled(noise, 1.0, 1e2)

    def failing(model, recording, noise, test):
        if noise.Q[1, 1] > start.Q[1, 1]:
            raise FilterDivergedError(1, 3, recording)
        return extended_kalman_filter(model, recording, noise, test)

    free = alg2.estimate(model, recordings, start)
    monkeypatch.setattr(path_search, "extended_kalman_filter", failing)
    result = alg2.estimate(model, recordings, start)
    assert np.isinf(result.trace["objective"][2])
    assert result.status == "converged"
    assert np.allclose(np.diag(result.final.Q), np.diag(free.final.Q), rtol=1e-3)


def test_a_filter_that_fails_on_both_sides_ends_the_search(monkeypatch):
    model, recordings, noise = tracking_case()

    def failing(model, recording, noise_now, test):
        if not np.array_equal(noise_now.Q, noise.Q):
            raise FilterDivergedError(1, 3, recording)
        return extended_kalman_filter(model, recording, noise_now, test)

    monkeypatch.setattr(path_search, "extended_kalman_filter", failing)
    result = alg2.estimate(model, recordings, noise)
    assert (result.status, result.passes) == ("numerical", 3)
    assert "fails on both sides" in result.reason
    assert np.array_equal(result.final.Q, noise.Q)


def test_a_filter_that_fails_at_the_start_is_an_error():
    model = linear_model([[1e60]], [[1.0]], [[1.0]])
    model = replace(model, performances=("z1",), performance=model.output)
    wild = Recording(
        "wild", np.ones(9), np.zeros((10, 0)), np.r_[np.full((9, 1), np.nan), [[0.0]]], z_true=np.zeros((10, 1))
    )
    with pytest.raises(FilterDivergedError, match="'wild'"):
        alg2.estimate(model, [wild], NoiseValues(np.eye(1), np.eye(1), np.ones((1, 1)), np.eye(1)))


def test_problems_without_an_answer_are_refused():
    model, recordings, noise = tracking_case(lengths=(10,))
    with pytest.raises(EstimationError, match="model 'linear' has none; em and alg3 do without"):
        alg2.estimate(replace(model, performance=None), recordings, noise)
    for truth in (None, np.full((10, 2), np.nan)):
        blind = replace(recordings[0], z_true=truth)
        with pytest.raises(EstimationError, match=r"'test-0' has no true z1, z2: .* em and alg3 do without"):
            alg2.estimate(model, [blind], noise)
    for Q in (np.array([[1.0, 0.1], [0.1, 1.0]]), np.diag([1.0, 0.0])):
        with pytest.raises(EstimationError, match="scales the variances of a diagonal start"):
            alg2.estimate(model, recordings, NoiseValues(Q, noise.R, noise.m0, noise.P0))
    with pytest.raises(EstimationError, match="lambda_span is 1; it must be above 1"):
        alg2.estimate(model, recordings, noise, Alg2Options(lambda_span=1.0))
    with pytest.raises(EstimationError, match="least_squares would never stop"):
        alg2.estimate(model, recordings, noise, Alg2Options(parameter_tolerance=0.0, objective_tolerance=0.0))

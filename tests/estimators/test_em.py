"""EM: monotone on linear models, the same end with and without acceleration, its stop rules and its outcomes."""

import numpy as np
import pytest
from pendulum import pendulum_case
from random_models import random_case, random_covariance
from scipy.optimize import minimize

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators import em
from noiseid_cli.estimators.em import EmOptions
from noiseid_cli.estimators.em_statistics import e_step
from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.estimators.unknowns import Unknowns
from noiseid_cli.filters.ekf import FilterDivergedError, extended_kalman_filter
from noiseid_cli.models.linear import linear_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording


def loglik(model, recordings, noise):
    return sum(extended_kalman_filter(model, r, noise, i).loglik for i, r in enumerate(recordings))


def full_unknowns(noise, P0=False):
    return Unknowns(
        Q=CovarianceStructure.full(noise.Q, "Q"),
        R=CovarianceStructure.diagonal(np.diag(np.diag(noise.R)), "R"),
        P0=CovarianceStructure.full(noise.P0, "P0") if P0 else None,
        m0=P0,
    )


def started(case, seed):
    """Other values than those that made the data."""
    rng = np.random.default_rng(seed)
    noise = case.noise
    tests, n = noise.m0.shape
    return NoiseValues(
        random_covariance(rng, len(noise.Q)), np.diag(np.diag(noise.R)) * 4.0, np.zeros((tests, n)), 2.0 * np.eye(n)
    )


@pytest.mark.parametrize("seed", range(20))
def test_plain_em_never_loses_likelihood_on_a_linear_model(seed):
    case = random_case(seed, 2, 1, 2, lengths=(30, 17, 24), missing=0.2)
    start = started(case, seed)
    options = EmOptions(acceleration="none", max_passes=30, parameter_tolerance=0.0, loglik_tolerance=0.0)
    result = em.estimate(case.model, case.recordings, start, full_unknowns(start, P0=True), options)
    values = result.trace["loglik"]
    assert np.all(np.diff(values) >= -1e-10 * np.abs(values[1:]))
    assert np.all(result.trace["extrapolated"] == 0)
    assert len(values) == result.passes


@pytest.mark.parametrize("seed", [0, 1, 3])
def test_both_forms_end_at_the_maximum_of_the_likelihood(seed):
    """A direct search over the same unknowns finds nothing better, and the two ends are one."""
    case = random_case(300 + seed, 2, 1, 1, lengths=(200,), missing=0.1)
    start = NoiseValues(case.noise.Q * 20, case.noise.R / 10, case.noise.m0, case.noise.P0)
    unknowns = full_unknowns(start)
    tight = {"parameter_tolerance": 1e-9, "loglik_tolerance": 1e-9, "max_passes": 3000}
    fast, plain = (
        em.estimate(case.model, case.recordings, start, unknowns, EmOptions(acceleration=a, **tight))
        for a in ("quasi_newton", "none")
    )
    assert fast.status == plain.status == "converged"
    assert fast.passes < plain.passes
    assert abs(fast.loglik - plain.loglik) < 1e-6
    found = minimize(
        lambda z: -loglik(case.model, case.recordings, unknowns.unpack(z, start)),
        unknowns.pack(fast.final),
        method="Nelder-Mead",
        options={"xatol": 1e-6, "fatol": 1e-9},
    )
    assert -found.fun <= fast.loglik + 1e-7
    assert np.allclose(fast.final.Q, plain.final.Q, rtol=1e-3)
    assert np.allclose(fast.final.R, plain.final.R, rtol=1e-3)


@pytest.mark.parametrize("linearisation", ["smoothed", "filtered"])
def test_nonlinear_model_is_identified_from_both_sides(linearisation):
    model, noise, recordings = pendulum_case(1, lengths=(300, 200))
    ends = []
    for factor in (0.01, 100.0):
        start = NoiseValues(noise.Q * factor, noise.R, noise.m0, noise.P0)
        options = EmOptions(linearisation=linearisation)
        ends.append(em.estimate(model, recordings, start, Unknowns(Q=CovarianceStructure.full(start.Q)), options))
    assert all(e.status == "converged" for e in ends)
    assert ends[0].settings["linearisation"] == linearisation
    assert abs(ends[0].loglik - ends[1].loglik) < 0.01
    assert np.isclose(ends[0].final.Q, ends[1].final.Q, rtol=2e-3)
    # 500 samples of noise determine a variance to about sqrt(2/500); three of these.
    assert abs(ends[0].final.Q[0, 0] / noise.Q[0, 0] - 1) < 3 * np.sqrt(2 / 500) * 1.5


def test_filtered_linearisation_is_nearer_to_the_filters_own_maximum():
    """`filtered` uses the statistics of the likelihood that is reported, so that its end is at least as high."""
    model, noise, recordings = pendulum_case(5, lengths=(400,), q=3.0, r=(0.3, 3.0))
    unknowns = Unknowns(Q=CovarianceStructure.full(noise.Q))
    ends = {
        kind: em.estimate(model, recordings, noise, unknowns, EmOptions(linearisation=kind, parameter_tolerance=1e-7))
        for kind in ("smoothed", "filtered")
    }
    assert ends["filtered"].loglik >= ends["smoothed"].loglik - 1e-6


def test_change_of_units_changes_the_answer_accordingly_and_nothing_else():
    """Outputs in milli-units, noise in kilo-units: same passes, transformed estimate."""
    case = random_case(21, 2, 2, 2, lengths=(300,), missing=0.1)
    start = started(case, 4)
    options = EmOptions(max_passes=25)
    a = em.estimate(case.model, case.recordings, start, full_unknowns(start), options)
    y, v = np.diag([1e3, 1e-2]), np.diag([1e-3, 1e4])
    model = linear_model(case.A, case.G @ np.linalg.inv(v), y @ case.C, case.B, y @ case.D)
    r = case.recordings[0]
    recordings = (Recording(r.name, r.dt, r.u, r.y * np.diag(y)),)
    other = NoiseValues(v @ start.Q @ v, y @ start.R @ y, start.m0, start.P0)
    b = em.estimate(model, recordings, other, full_unknowns(other), options)
    assert a.passes == b.passes
    assert np.array_equal(a.trace["extrapolated"], b.trace["extrapolated"])
    assert np.array_equal(a.trace["accepted"], b.trace["accepted"])
    assert np.allclose(np.linalg.inv(v) @ b.final.Q @ np.linalg.inv(v), a.final.Q, rtol=1e-8)
    assert np.allclose(np.linalg.inv(y) @ b.final.R @ np.linalg.inv(y), a.final.R, rtol=1e-8)


def test_order_of_the_tests_does_not_matter():
    case = random_case(12, 2, 1, 2, lengths=(40, 25, 60))
    start = started(case, 1)
    swapped = NoiseValues(start.Q, start.R, start.m0[::-1], start.P0)
    a = em.estimate(case.model, case.recordings, start, full_unknowns(start))
    b = em.estimate(case.model, case.recordings[::-1], swapped, full_unknowns(swapped))
    assert np.allclose(a.final.Q, b.final.Q, rtol=1e-9)


def test_initial_mean_and_covariance_of_many_tests():
    """With the outputs nearly exact, m0 and P0 are the sample mean and covariance of the first states."""
    rng = np.random.default_rng(2)
    m0, P0 = np.array([1.0, -2.0]), np.array([[1.0, 0.6], [0.6, 2.0]])
    first = rng.multivariate_normal(m0, P0, size=50)
    recordings = [Recording(f"t{i}", np.ones(1), np.zeros((2, 0)), np.tile(x, (2, 1))) for i, x in enumerate(first)]
    start = NoiseValues(1e-10 * np.eye(2), 1e-10 * np.eye(2), np.zeros((50, 2)), np.eye(2))
    unknowns = Unknowns(P0=CovarianceStructure.full(start.P0), m0=True)
    end = em.estimate(linear_model(np.eye(2), np.eye(2), np.eye(2)), recordings, start, unknowns).final
    assert np.allclose(end.m0, first.mean(axis=0), atol=1e-6)
    assert np.allclose(end.P0, np.cov(first.T, bias=True), atol=1e-6)


@pytest.mark.parametrize(
    ("options", "status"),
    [
        ({"max_passes": 3}, "max_passes"),
        ({"stop": "loglik", "loglik_tolerance": 10.0, "parameter_tolerance": 0.0}, "converged"),
        ({"stop": "parameters", "parameter_tolerance": 0.5, "loglik_tolerance": 0.0}, "converged"),
        ({"stop": "both", "parameter_tolerance": 0.5, "loglik_tolerance": 0.0, "max_passes": 8}, "max_passes"),
    ],
)
def test_stop_rules(options, status):
    case = random_case(13, lengths=(60,))
    start = started(case, 2)
    seen = []
    result = em.estimate(
        case.model,
        case.recordings,
        start,
        full_unknowns(start),
        EmOptions(**options),
        lambda k, ll: seen.append((k, ll)),
    )
    assert result.status == status
    assert [k for k, _ in seen] == list(range(1, result.passes + 1))
    assert [ll for _, ll in seen] == result.trace["loglik"].tolist()
    assert result.passes <= options.get("max_passes", 500)
    assert result.loglik == max(result.trace["loglik"])


def test_the_papers_stop_rule_stops_when_the_likelihood_stops_rising():
    case = random_case(14, 1, 1, 1, lengths=(200,), missing=0.0)
    start = NoiseValues(case.noise.Q * 5, case.noise.R, case.noise.m0, case.noise.P0)
    options = EmOptions(stop="loglik", loglik_tolerance=0.0, acceleration="none", max_passes=20000)
    result = em.estimate(case.model, case.recordings, start, Unknowns(Q=CovarianceStructure.full(start.Q)), options)
    assert result.status == "converged"
    rises = np.diff(result.trace["loglik"])
    assert np.all(rises[:-1] > 0)
    assert rises[-1] <= 0


def test_rejected_jumps_are_recorded_and_the_tolerance_lets_them_pass():
    """On a jagged likelihood a jump may land lower: rejected by default, taken within a stated tolerance."""
    model, noise, recordings = pendulum_case(3, lengths=(60,), q=8.0, r=(0.5, 5.0))
    start = NoiseValues(noise.Q * 1e-4, noise.R * 10, noise.m0, noise.P0)
    unknowns = Unknowns(Q=CovarianceStructure.full(start.Q), R=CovarianceStructure.diagonal(start.R))
    strict = em.estimate(model, recordings, start, unknowns)
    loose = em.estimate(model, recordings, start, unknowns, EmOptions(fall_tolerance=1e9))
    assert np.all(loose.trace["accepted"] == 1)
    rejected = int(np.sum(strict.trace["accepted"] == 0))
    assert rejected == 0 or any(f"{rejected} accelerated step" in s for s in strict.safeguards)
    assert strict.loglik == max(strict.trace["loglik"])


def test_a_fall_of_plain_em_is_reported_with_its_size():
    """Far from linear the smoothed linearisation may lose likelihood: counted, sized, and the best point kept."""
    for seed in range(30):
        model, noise, recordings = pendulum_case(seed, lengths=(60,), q=8.0, r=(0.5, 5.0))
        start = NoiseValues(noise.Q * 1e-2, noise.R, noise.m0, noise.P0)
        options = EmOptions(acceleration="none", max_passes=60)
        result = em.estimate(model, recordings, start, Unknowns(Q=CovarianceStructure.full(start.Q)), options)
        falls = -np.diff(result.trace["loglik"])
        if falls.max() > 1e-3:
            said = [s for s in result.safeguards if "fell in" in s]
            assert f"by {falls.max():.3g} at most" in said[0]
            assert "`linearisation: filtered` may do better" in said[0]
            assert result.loglik == max(result.trace["loglik"])
            return
    raise AssertionError("no case with a fall was found; take a rougher one")


def test_a_direction_that_goes_to_zero_is_reported():
    """The second noise is not there at all: its variance runs to zero, and the result says so."""
    rng = np.random.default_rng(0)
    y = np.column_stack([np.cumsum(rng.normal(size=400)), np.zeros(400)]) + 1e-3 * rng.normal(size=(400, 2))
    recording = Recording("r", np.ones(399), np.zeros((400, 0)), y)
    start = NoiseValues(np.eye(2), 1e-6 * np.eye(2), np.zeros((1, 2)), np.eye(2))
    options = EmOptions(max_passes=200, parameter_tolerance=1e-3)
    result = em.estimate(
        linear_model(np.eye(2), np.eye(2), np.eye(2)), [recording], start,
        Unknowns(Q=CovarianceStructure.diagonal(start.Q, "Q")), options,
    )  # fmt: skip
    assert result.final.Q[1, 1] < 1e-8
    assert any("Q is going to zero along one direction" in s for s in result.safeguards)


def test_divergence_at_the_start_and_later():
    model = linear_model([[1e60]], [[1.0]], [[1.0]])
    recording = Recording("wild", np.ones(9), np.zeros((10, 0)), np.r_[np.full((9, 1), np.nan), [[0.0]]])
    noise = NoiseValues(np.eye(1), np.eye(1), np.ones((1, 1)), np.eye(1))
    with pytest.raises(FilterDivergedError, match="'wild'"):
        em.estimate(model, [recording], noise, Unknowns(Q=CovarianceStructure.full(noise.Q)))


@pytest.mark.parametrize(
    ("unknowns", "text"),
    [
        (Unknowns(), "nothing is unknown"),
        (Unknowns(P0=CovarianceStructure.full(np.eye(3), "P0")), "cannot be estimated from 1 test"),
        (Unknowns(Q=CovarianceStructure.full(np.zeros((2, 2)), "Q")), "zero is a fixed point of EM"),
    ],
)
def test_problems_without_an_answer_are_refused(unknowns, text):
    case = random_case(1)
    with pytest.raises(EstimationError, match=text):
        em.estimate(case.model, case.recordings, case.noise, unknowns)


def test_known_parts_stay_as_they_are():
    case = random_case(15, lengths=(50, 50))
    result = em.estimate(
        case.model, case.recordings, case.noise, Unknowns(R=CovarianceStructure.full(case.noise.R, "R"))
    )
    assert result.final.Q is case.noise.Q
    assert result.final.P0 is case.noise.P0
    assert np.array_equal(result.final.m0, case.noise.m0)
    assert not np.array_equal(result.final.R, case.noise.R)
    assert result.loglik == pytest.approx(e_step(case.model, case.recordings, result.final).loglik, abs=1e-9)

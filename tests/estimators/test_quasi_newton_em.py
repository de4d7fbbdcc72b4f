"""Accelerated EM: the ends of plain EM in fewer passes, its step by a dense twin, and what keeps it safe."""

from dataclasses import replace

import numpy as np
import pytest
from pendulum import pendulum_case
from random_models import random_case

from noiseid_cli.estimators import em, quasi_newton_em
from noiseid_cli.estimators.em import EmOptions
from noiseid_cli.estimators.em_run import EmRun
from noiseid_cli.estimators.em_statistics import SMOOTHED
from noiseid_cli.estimators.quasi_newton_em import QuasiNewtonEm
from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.estimators.unknowns import Unknowns
from noiseid_cli.models.linear import linear_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording

TIGHT = {"parameter_tolerance": 1e-7, "loglik_tolerance": 1e-9, "max_passes": 2000}
LEVEL = linear_model([[1.0]], [[1.0]], [[1.0]])


def rotation_case():
    """Two states that turn, both measured, in short tests: everything about their noise can be told."""
    rng = np.random.default_rng(8)
    A, recordings = np.array([[0.9, 0.3], [-0.3, 0.8]]), []
    for i in range(6):
        x, y = np.array([1.0, -2.0]) + rng.normal(size=2), np.empty((40, 2))
        for k in range(40):
            y[k] = x + rng.normal(size=2) * (0.6, 0.4)
            x = A @ x + rng.normal(size=2) @ np.array([[1.0, 0.3], [0.0, 0.7]])
        y[rng.uniform(size=y.shape) < 0.1] = np.nan
        recordings.append(Recording(f"test-{i}", np.ones(39), np.zeros((40, 0)), y))
    return linear_model(A, np.eye(2), np.eye(2)), recordings


MODEL, RECORDINGS = rotation_case()
START = NoiseValues(np.diag([20.0, 0.05]), np.diag([0.1, 9.0]), np.zeros((6, 2)), np.diag([1.0, 2.0]))


def structures():
    """One of each kind that Q can have beside R, and the first state: where to start, and what is unknown."""
    full, diagonal = CovarianceStructure.full, CovarianceStructure.diagonal
    R, two, equal = diagonal(START.R), ((0, 1),), replace(START, Q=np.eye(2))
    held = CovarianceStructure(START.Q, two, held=frozenset({(1, 0)}))
    tied = CovarianceStructure(equal.Q, ((0,), (1,)), tied=two)
    fitting = replace(equal, R=np.diag([0.36, 0.16]))
    return {
        "full": (START, Unknowns(full(START.Q), R)),
        "diagonal, R full": (START, Unknowns(diagonal(START.Q), full(START.R))),
        "scale": (START, Unknowns(CovarianceStructure.scaled(START.Q), R)),
        "held": (START, Unknowns(held, R)),
        "tied": (equal, Unknowns(tied, R)),
        "first state": (fitting, Unknowns(None, None, diagonal(START.P0), m0=True)),
    }


@pytest.mark.parametrize("kind", structures())
def test_ends_are_those_of_plain_em_in_fewer_passes(kind):
    start, unknowns = structures()[kind]
    fast, plain = (
        em.estimate(MODEL, RECORDINGS, start, unknowns, EmOptions(acceleration=a, **TIGHT))
        for a in ("quasi_newton", "none")
    )
    assert fast.status == plain.status == "converged"
    assert fast.passes < 0.7 * plain.passes
    assert abs(fast.loglik - plain.loglik) < 1e-6
    for letter in ("Q", "R", "m0", "P0"):
        assert np.allclose(getattr(fast.final, letter), getattr(plain.final, letter), rtol=1e-3, atol=1e-4), letter


def test_a_first_state_that_is_known_in_part_and_an_output_never_seen_are_no_obstacle():
    """What the data say nothing of has no information to divide by: it stays, and all else is found as fast."""
    recordings = [replace(r, y=np.column_stack([r.y[:, 0], np.full(len(r.y), np.nan)])) for r in RECORDINGS]
    start = replace(START, P0=np.diag([1.0, 0.0]))
    unknowns = Unknowns(CovarianceStructure.scaled(start.Q), CovarianceStructure.diagonal(start.R), None, m0=True)
    fast, plain = (
        em.estimate(MODEL, recordings, start, unknowns, EmOptions(acceleration=a, max_passes=150))
        for a in ("quasi_newton", "none")
    )
    assert fast.status == "converged"
    assert fast.passes < 0.5 * plain.passes
    assert fast.loglik > plain.loglik - 1e-3
    assert np.isclose(fast.final.R[1, 1], start.R[1, 1], rtol=1e-12)
    assert np.all(fast.final.m0[:, 1] == 0.0)


def test_nothing_moves_from_the_end_of_plain_em():
    """Fixed points are EM's: smoothed moments, whose fixed point is not the top of the filter's likelihood."""
    model, noise, recordings = pendulum_case(2, lengths=(200,), q=2.0)
    unknowns = Unknowns(CovarianceStructure.full(noise.Q), CovarianceStructure.diagonal(noise.R))
    end = em.estimate(model, recordings, noise, unknowns, EmOptions(acceleration="none", **TIGHT)).final
    again = em.estimate(model, recordings, end, unknowns, EmOptions(parameter_tolerance=1e-7))
    assert (again.status, again.passes) == ("converged", 2)
    assert unknowns.change(end, again.final) <= 1e-7


def test_a_noise_that_is_not_there_is_found_out_soon():
    """Plain EM needs thousands of passes to send a variance to zero; the log-likelihood is that of no such noise."""
    y = np.random.default_rng(4).normal(size=400)
    recording = Recording("white", np.ones(399), np.zeros((400, 0)), y[:, None])
    start = NoiseValues(np.eye(1), np.eye(1), np.zeros((1, 1)), np.eye(1))
    unknowns = Unknowns(CovarianceStructure.full(start.Q), CovarianceStructure.full(start.R))
    result = em.estimate(LEVEL, [recording], start, unknowns)
    assert result.status == "converged"
    assert result.passes < 40
    without = replace(result.final, Q=np.full((1, 1), 1e-14))
    still = em.estimate(LEVEL, [recording], without, Unknowns(None, unknowns.R))
    assert result.loglik >= still.loglik - 0.01


def visited(count):
    """A run after some plain EM steps, and the acceleration that saw them all but took none of its own."""
    unknowns = Unknowns(CovarianceStructure.full(START.Q), CovarianceStructure.diagonal(START.R))
    run = EmRun(MODEL, RECORDINGS, unknowns, SMOOTHED, None, 1e-3)
    acceleration = QuasiNewtonEm(run)
    point = run.visit(START)
    for _ in range(count):
        proposed = acceleration.propose(point)
        point = run.visit(point.after)
    return run, acceleration, point, proposed


@pytest.mark.parametrize("memory", [3, 20])
def test_the_step_is_that_of_a_dense_bfgs_update(memory, monkeypatch):
    """The recursion over the secants gives B g with B by Nocedal & Wright, eq. 6.17, from the scaled unit."""
    monkeypatch.setattr(quasi_newton_em, "MEMORY", memory)
    _, acceleration, point, _ = visited(6)
    acceleration.propose(point)
    seen, secants = acceleration._last, list(acceleration._secants)
    assert 2 < len(secants) <= memory
    s, y = secants[-1]
    B = np.linalg.inv(seen.complete)
    B *= max(1.0, (s @ y) / (y @ B @ y))
    for s, y in secants:
        left = np.eye(len(s)) - np.outer(s, y) / (s @ y)
        B = left @ B @ left.T + np.outer(s, s) / (s @ y)
    assert np.allclose(acceleration._direction(seen), B @ seen.gradient, rtol=1e-8)
    # What the last secant has taught: the change of the score that it saw is its own length.
    assert np.allclose(acceleration._direction(replace(seen, gradient=y)), s, rtol=1e-8)


def test_steps_are_bounded_shorter_after_a_rejection_and_longer_after_success():
    run, acceleration, point, _ = visited(6)
    acceleration._longest = 0.3
    z = run.unknowns.pack(point.noise)

    def longest_step():
        return np.max(np.abs(run.unknowns.pack(acceleration.propose(point)) - z))

    first = longest_step()
    assert np.isclose(first, 0.3)
    acceleration.learn(None)
    assert np.isclose(acceleration._longest, 0.3 * quasi_newton_em.SHRINKAGE)
    acceleration._longest = 0.3
    acceleration.learn(replace(point, accepted=True))
    assert np.isclose(acceleration._longest, 0.3 * quasi_newton_em.GROWTH)
    # A bound below the EM step itself: that is taken, and leads out of the bound.
    acceleration._longest = 1e-6
    assert acceleration.propose(point) is None
    assert acceleration._longest > 1e-6


def test_a_rejected_point_teaches_its_secant():
    run, acceleration, point, _ = visited(3)
    proposed = acceleration.propose(point)
    before = len(acceleration._secants)
    tried = run.attempt(proposed, np.inf)
    assert not tried.accepted
    acceleration.learn(tried)
    assert len(acceleration._secants) == before + 1
    s, _ = acceleration._secants[-1]
    assert np.allclose(s, run.unknowns.pack(proposed) - run.unknowns.pack(point.noise), atol=1e-12)


@pytest.mark.parametrize("tolerance", [0.0, 1e-3, 1.0])
def test_accepted_points_lose_no_more_than_the_tolerance(tolerance):
    """On a likelihood with sharp bends, where some proposals fall: the accepted path never does by more."""
    model, noise, recordings = pendulum_case(3, lengths=(60,), q=8.0, r=(0.5, 5.0))
    start = NoiseValues(noise.Q * 1e-2, noise.R * 100, noise.m0, noise.P0)
    unknowns = Unknowns(CovarianceStructure.full(start.Q), CovarianceStructure.diagonal(start.R))
    result = em.estimate(model, recordings, start, unknowns, EmOptions(fall_tolerance=tolerance, max_passes=60))
    accepted = result.trace["accepted"] == 1.0
    loglik = result.trace["loglik"][accepted]
    jumps = result.trace["extrapolated"][accepted][1:] == 1.0
    assert jumps.any()
    assert np.all(np.diff(loglik)[jumps] >= -tolerance)
    rejected = int(np.sum(~accepted))
    assert any(f"{rejected} accelerated step" in s for s in result.safeguards) == (rejected > 0)


@pytest.mark.parametrize("stop", ["both", "loglik", "parameters"])
def test_rest_is_declared_after_an_em_step(stop):
    unknowns = structures()["full"][1]
    result = em.estimate(MODEL, RECORDINGS, START, unknowns, EmOptions(stop=stop))
    assert result.status == "converged"
    assert result.trace["extrapolated"][-1] == 0.0
    assert np.any(result.trace["extrapolated"] == 1.0)


def test_bad_proposals_cost_passes_and_change_nothing(monkeypatch):
    """Points that are no covariance, make the filter fail, or are worse: all told, and the end is plain EM's."""

    class Wild:
        def __init__(self, run):
            self.calls, self.learned = 0, []

        def propose(self, now):
            bad = (now.noise.Q * np.nan, -now.noise.Q, now.noise.Q * 1e305, now.noise.Q * 1e6)
            self.calls += 1
            return replace(now.noise, Q=bad[self.calls % 4])

        def learn(self, tried):
            assert tried is None or not tried.accepted

    case = random_case(5, 1, 1, 1, lengths=(60,), missing=0.0)
    start = NoiseValues(case.noise.Q * 5, case.noise.R, case.noise.m0, case.noise.P0)
    unknowns = Unknowns(CovarianceStructure.full(start.Q))
    plain = em.estimate(case.model, case.recordings, start, unknowns, EmOptions(acceleration="none"))
    monkeypatch.setitem(em.ACCELERATIONS, "quasi_newton", Wild)
    wild = em.estimate(case.model, case.recordings, start, unknowns)
    assert wild.status == "converged"
    assert np.array_equal(wild.final.Q, plain.final.Q)
    assert wild.passes > plain.passes
    assert np.sum(wild.trace["accepted"]) == plain.passes
    for words in ("led to what is no covariance", "lowered the log-likelihood"):
        assert any(words in s for s in wild.safeguards), words

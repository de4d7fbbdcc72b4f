"""Standard errors and identifiability: against exact information, Monte Carlo, and EM's own rate of convergence."""

from dataclasses import replace

import numpy as np
import pytest
from pendulum import pendulum_case
from random_models import random_case

from noiseid_cli.estimators import em
from noiseid_cli.estimators.score import score
from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.estimators.uncertainty import uncertainty
from noiseid_cli.estimators.unknowns import Unknowns
from noiseid_cli.filters.ekf import extended_kalman_filter
from noiseid_cli.models.linear import linear_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording

TIGHT = em.EmOptions(linearisation="filtered", parameter_tolerance=1e-9, loglik_tolerance=1e-9, max_passes=3000)


def loglik(model, recordings, noise):
    return sum(extended_kalman_filter(model, r, noise, i).loglik for i, r in enumerate(recordings))


def numerical_slope(model, recordings, noise, unknowns):
    z, h = unknowns.pack(noise), 1e-5
    sides = [
        [loglik(model, recordings, unknowns.unpack(z + s * h * e, noise)) for s in (-1, 1)] for e in np.eye(len(z))
    ]
    return np.array([(high - low) / (2 * h) for low, high in sides])


def diagonal(P):
    return np.diag(np.diag(P))


def problems(case):
    """Unknowns of every structure, with noise values that fit them."""
    n = case.noise
    same = np.tile(n.m0.mean(axis=0), (len(n.m0), 1))
    full, diag, scaled = CovarianceStructure.full, CovarianceStructure.diagonal, CovarianceStructure.scaled
    held = CovarianceStructure(n.Q, ((0, 1),), held=frozenset({(1, 0)}), what="Q")
    return {
        "Q full, R diagonal, m0": (
            replace(n, R=diagonal(n.R), m0=same),
            Unknowns(Q=full(n.Q), R=diag(diagonal(n.R)), m0=True),
        ),
        "Q diagonal, R full, P0": (replace(n, Q=diagonal(n.Q)), Unknowns(diag(diagonal(n.Q)), full(n.R), full(n.P0))),
        "Q scaled": (n, Unknowns(Q=scaled(n.Q))),
        "R scaled, Q held in part": (n, Unknowns(Q=held, R=scaled(n.R))),
    }


@pytest.mark.parametrize("kind", list(problems(random_case(0))))
def test_score_is_the_slope_of_the_loglikelihood_of_a_linear_model(kind):
    case = random_case(3, 3, 2, 2, lengths=(40, 25), missing=0.2 if "scaled" not in kind else 0.0)
    noise, unknowns = problems(case)[kind]
    ours = score(case.model, case.recordings, noise, unknowns).gradient
    slope = numerical_slope(case.model, case.recordings, noise, unknowns)
    np.testing.assert_allclose(ours, slope, atol=1e-6 * max(1.0, np.max(np.abs(slope))))


def test_score_of_a_nonlinear_model_is_that_of_the_filter_but_for_moving_linearisation():
    """What is left out must be small beside a standard error, sqrt(1 / information)."""
    model, noise, recordings = pendulum_case(1, lengths=(200, 200))
    unknowns = Unknowns(Q=CovarianceStructure.full(noise.Q), R=CovarianceStructure.diagonal(noise.R))
    ours = score(model, recordings, noise, unknowns)
    slope = numerical_slope(model, recordings, noise, unknowns)
    errors = 1 / np.sqrt(np.diag(ours.complete))
    assert np.max(np.abs(ours.gradient - slope) * errors) < 0.1
    assert np.max(np.abs(slope) * errors) > 0.3  # so that the comparison says something


@pytest.mark.parametrize("kind", list(problems(random_case(0))))
def test_derivatives_of_each_structure_are_exact(kind):
    noise, unknowns = problems(random_case(4))[kind]
    for _, structure, (value,) in unknowns.covariances(noise):
        z, h = structure.coordinates(value), 1e-6
        assert len(structure.coordinate_places) == len(z)
        for a, derivative in enumerate(structure.jacobian(z)):
            d = h * np.eye(len(z))[a]
            difference = (structure.covariance(z + d) - structure.covariance(z - d)) / (2 * h)
            np.testing.assert_allclose(derivative, difference, atol=1e-8)


def local_level(seed, N, q=1.0, r=1.0, x0=0.0):
    """A random walk with noise, from a known first state; and its dense covariance S = q A + r I."""
    rng = np.random.default_rng(seed)
    level = x0 + np.concatenate(([0.0], np.cumsum(q * rng.normal(size=N - 1))))
    y = (level + r * rng.normal(size=N))[:, None]
    k = np.arange(N)
    return Recording("walk", np.ones(N - 1), np.zeros((N, 0)), y), np.minimum.outer(k, k).astype(float)


WALK = linear_model(A=[[1.0]], G=[[1.0]], C=[[1.0]])


def walk_noise(q, r):
    return NoiseValues(np.array([[q**2]]), np.array([[r**2]]), np.zeros((1, 1)), np.zeros((1, 1)))


def walk_unknowns(noise, R=True):
    full = CovarianceStructure.full
    return Unknowns(Q=full(noise.Q, "Q"), R=full(noise.R, "R") if R else None)


def test_standard_errors_are_those_of_the_exact_information():
    """Observed information of (log q, log r) by the derivatives of the dense Gaussian, S = q^2 A + r^2 I."""
    N = 300
    recording, A = local_level(5, N, q=0.7, r=1.3)
    start = walk_noise(1.0, 1.0)
    unknowns = walk_unknowns(start)
    end = em.estimate(WALK, [recording], start, unknowns, TIGHT).final
    ours = uncertainty(WALK, [recording], end, unknowns, level=0.9)
    q2, r2, y = end.Q[0, 0], end.R[0, 0], recording.y[:, 0]
    inverse = np.linalg.inv(q2 * A + r2 * np.eye(N))
    parts = [inverse @ (2 * q2 * A), inverse @ (2 * r2 * np.eye(N))]
    w = inverse @ y
    exact = np.array([[y @ a @ b @ w - 0.5 * np.trace(a @ b) for b in parts] for i, a in enumerate(parts)])
    # The coordinates are logs: their own curvature adds 2 dl/dlog on the diagonal, zero at the maximum.
    slopes = [0.5 * (y @ a @ w - np.trace(a)) for a in parts]
    exact -= np.diag([2 * s for s in slopes])
    np.testing.assert_allclose(ours.information, 0.5 * (exact + exact.T), rtol=3e-3)
    errors = np.sqrt(np.diag(np.linalg.inv(exact)))
    np.testing.assert_allclose(ours.standard_errors, errors * np.sqrt([q2, r2]), rtol=3e-3)
    # Intervals of 90 % on the log scale.
    np.testing.assert_allclose(np.log(ours.upper / ours.lower) / 2, 1.644854 * errors, rtol=3e-3)
    assert [name[:2] for name in ours.names] == [("process_noise_std", "v1"), ("measurement_noise_std", "y1")]
    assert ours.coordinates == ("Q v1", "R y1")
    assert not ours.remarks
    assert not any(ours.notes)


def test_intervals_cover_the_truth_as_often_as_they_say():
    """80 replicates of two figures: 95 % up to four binomial standard deviations of 80 trials."""
    truth, hits, z = np.array([0.8, 1.2]), [], []
    for seed in range(80):
        recording, _ = local_level(100 + seed, 400, *truth)
        start = walk_noise(*truth)
        unknowns = walk_unknowns(start)
        end = em.estimate(WALK, [recording], start, unknowns, em.EmOptions(linearisation="filtered")).final
        u = uncertainty(WALK, [recording], end, unknowns)
        hits.append((u.lower <= truth) & (truth <= u.upper))
        z.append(np.log(u.values / truth) * u.values / u.standard_errors)
    share = np.mean(hits, axis=0)
    assert np.all(np.abs(share - 0.95) < 4 * np.sqrt(0.95 * 0.05 / 80))
    # On the log scale the mean of z^2 is 1 with standard error sqrt(2 / 80).
    assert np.all(np.abs(np.mean(np.square(z), axis=0) - 1) < 4 * np.sqrt(2 / 80))


def test_shares_are_one_less_the_rate_at_which_em_converges():
    """The eigenvalues of EM's Jacobian at its fixed point (Dempster, Laird & Rubin)."""
    case = random_case(14, 3, 2, 2, lengths=(300,), missing=0.1)
    unknowns = Unknowns(Q=CovarianceStructure.diagonal(diagonal(case.noise.Q), "Q"))
    end = em.estimate(case.model, case.recordings, replace(case.noise, Q=unknowns.Q.start), unknowns, TIGHT).final
    z = unknowns.pack(end)

    def step(at):
        one = em.EmOptions(linearisation="filtered", max_passes=2, acceleration="none")
        point = unknowns.unpack(at, end)
        second = em.estimate(case.model, case.recordings, point, unknowns, one).trace["Q"][1]
        return unknowns.pack(replace(end, Q=second))

    h = 1e-3
    rates = np.array([(step(z + h * e) - step(z - h * e)) / (2 * h) for e in np.eye(2)]).T
    shares = uncertainty(case.model, case.recordings, end, unknowns).shares
    # Differences of a step h = 0.5 / sqrt(600) err by h^2 relative to the complete-data information.
    np.testing.assert_allclose(shares, np.sort(1 - np.linalg.eigvals(rates).real), atol=0.5**2 / 600)


def test_a_variance_at_zero_gets_a_one_sided_bound():
    """White data with R known: the bound is where the exact log-likelihood has fallen by 1.645^2 / 2."""
    N, seed = 150, next(s for s in range(50) if zero_is_best(s))
    recording, A = local_level(seed, N, q=0.0)
    noise = walk_noise(1e-6, 1.0)
    ours = uncertainty(WALK, [recording], noise, walk_unknowns(walk_noise(0.1, 1.0), R=False))
    y = recording.y[:, 0]

    def exact(q2):
        S = q2 * A + np.eye(N)
        return -0.5 * (np.linalg.slogdet(S)[1] + y @ np.linalg.solve(S, y))

    assert ours.lower[0] == 0.0
    assert exact(0.0) - exact(ours.upper[0] ** 2) == pytest.approx(0.5 * 1.644854**2, rel=0.05)
    assert np.isfinite(ours.standard_errors[0])
    assert ours.standard_errors[0] > 0
    assert "one-sided" in ours.notes[0]


def zero_is_best(seed):
    recording, A = local_level(seed, 150, q=0.0)
    y = recording.y[:, 0]
    return 0.5 * (y @ A @ y - np.trace(A)) < 0


def test_two_noises_that_look_alike_are_called_a_ridge():
    """Two random walks of which only the sum is seen, told apart by poles that hardly differ."""
    model = linear_model(A=np.diag([0.9, 0.88]), G=np.eye(2), C=[[1.0, 1.0]])
    rng = np.random.default_rng(2)
    N, x = 400, np.zeros(2)
    y = np.empty((N, 1))
    for k in range(N):
        y[k] = x.sum() + 0.1 * rng.normal()
        x = np.array([0.9, 0.88]) * x + rng.normal(size=2)
    recording = Recording("twins", np.ones(N - 1), np.zeros((N, 0)), y)
    noise = NoiseValues(np.eye(2), np.array([[0.01]]), np.zeros((1, 2)), np.eye(2))
    unknowns = Unknowns(Q=CovarianceStructure.full(noise.Q, "Q"))
    end = em.estimate(model, [recording], noise, unknowns, em.EmOptions(linearisation="filtered")).final
    ours = uncertainty(model, [recording], end, unknowns)
    wide = [k for k, name in enumerate(ours.names) if name[0] == "process_noise_correlation"]
    assert any("v1" in text and "v2" in text for text in ours.directions + ours.remarks)
    assert ours.shares[0] < 0.01
    assert ours.upper[wide[0]] - ours.lower[wide[0]] > 1.0

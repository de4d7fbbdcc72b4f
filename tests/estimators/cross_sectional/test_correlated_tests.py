"""Tests that share a bias: conditional likelihood against the dense Gaussian of all tests, and the recursion."""

from dataclasses import replace

import numpy as np
import pytest
from dense_cross_section import dense_moments, random_tests, unpack_complex

from noiseid_cli.errors import EstimationError, ModelError
from noiseid_cli.estimators.cross_sectional.batch import BatchOptions, batch_ml
from noiseid_cli.estimators.cross_sectional.correlated import Carried, correlated, with_output_bias
from noiseid_cli.estimators.cross_sectional.evaluate import partitioned
from noiseid_cli.estimators.cross_sectional.problem import CommonBias, Coordinates, CrossSection, Theta
from noiseid_cli.estimators.cross_sectional.recursive import continue_recursion, recursive_ml
from noiseid_cli.estimators.cross_sectional.recursive_state import RecursiveOptions, RecursiveState
from tests.oracles.markov import INITIAL_STATE_MAP, markov_matrices
from tests.oracles.markov_tests import simulate_markov_tests

START = Theta(np.zeros(2), np.diag([0.5, 0.5]), np.array([0.01, 0.04]))


def sharing(seed, walk, lengths=(4, 6, 5)):
    """Random tests, and the same with a bias of both outputs that they share."""
    tests, theta, coordinates = random_tests(seed, lengths, nb=2, nx=3, varying=False)
    rng = np.random.default_rng(seed + 100)
    E = rng.normal(size=(2, 1))
    family, maps = with_output_bias(tests.family, tests.maps, E)
    common = CommonBias(np.array([[0.7]]), np.array([[walk]]))
    return tests, CrossSection(family, tests.recordings, maps, common), E, theta, coordinates


def joint_moments(tests, E, common, theta):
    """Mean, covariance and data of all tests as one Gaussian; outputs of test i have E c_i added."""
    parts = [dense_moments(tests.family, r, T, theta) for r, T in zip(tests.recordings, tests.maps, strict=True)]
    seen = [~np.isnan(r.y.ravel()) for r in tests.recordings]
    G = [np.tile(E, (r.samples, 1))[s] for r, s in zip(tests.recordings, seen, strict=True)]
    ends = np.cumsum([0, *(len(g) for g in G)])
    S = np.zeros((ends[-1], ends[-1]), dtype=complex)
    for i, (_, own, _) in enumerate(parts):
        S[ends[i] : ends[i + 1], ends[i] : ends[i + 1]] = own
        for k in range(len(G)):
            shared = common.first + min(i, k) * common.walk
            S[ends[i] : ends[i + 1], ends[k] : ends[k + 1]] += G[i] @ shared @ G[k].T
    return np.concatenate([m for m, _, _ in parts]), S, np.concatenate([y for _, _, y in parts])


def joint_derivatives(tests, E, common, theta, coordinates):
    """Moments at theta, and their derivatives by complex step."""
    h = 1e-30
    steps = coordinates.pack(theta) + 1j * h * np.eye(coordinates.size)
    moved = [joint_moments(tests, E, common, unpack_complex(coordinates, v)) for v in steps]
    m, S, y = joint_moments(tests, E, common, theta)
    return m.real, S.real, y, [d[0].imag / h for d in moved], [d[1].imag / h for d in moved]


@pytest.mark.parametrize(("seed", "walk"), [(1, 0.0), (2, 0.3)])
def test_sum_of_conditional_likelihoods_is_the_joint_one(seed, walk):
    tests, shared, E, theta, coordinates = sharing(seed, walk)
    m, S, y, dm, dS = joint_derivatives(tests, E, shared.common, theta, coordinates)
    e, _ = correlated(shared, theta, coordinates)
    w = np.linalg.solve(S, y - m)
    np.testing.assert_allclose(e.nll.sum(), 0.5 * (np.linalg.slogdet(S)[1] + (y - m) @ w), rtol=1e-11)
    gradient = [-d @ w - 0.5 * w @ V @ w + 0.5 * np.trace(np.linalg.solve(S, V)) for d, V in zip(dm, dS, strict=True)]
    np.testing.assert_allclose(e.gradient.sum(axis=0), gradient, rtol=1e-9, atol=1e-9)


def test_information_is_on_average_that_of_the_joint_gaussian():
    """Mean over 400 data sets of (30), every entry within 4.5 of its standard errors."""
    tests, shared, E, theta, coordinates = sharing(3, 0.3, lengths=(3, 4, 3))
    m, S, _, dm, dS = joint_derivatives(tests, E, shared.common, theta, coordinates)
    weight = np.linalg.inv(S)
    scaled = [weight @ V for V in dS]
    fisher = np.array(dm) @ weight @ np.array(dm).T + 0.5 * np.einsum("aij,bji->ab", scaled, scaled)
    rng, draws = np.random.default_rng(5), []
    for y in rng.multivariate_normal(m, S, size=400):
        at = 0
        recordings = []
        for r in shared.recordings:
            new = r.y.copy()
            seen = ~np.isnan(new)
            new[seen] = y[at : at + seen.sum()]
            at += seen.sum()
            recordings.append(replace(r, y=new))
        e, _ = correlated(replace(shared, recordings=tuple(recordings)), theta, coordinates)
        draws.append(e.information.sum(axis=0))
    scale = np.sqrt(np.outer(np.diag(fisher), np.diag(fisher)))
    error = np.std(draws, axis=0, ddof=1) / 20.0 + 1e-10 * scale
    assert np.max(np.abs(np.mean(draws, axis=0) - fisher) / error) < 4.5


def test_a_bias_known_to_be_zero_gives_independent_tests():
    tests, shared, _, theta, coordinates = sharing(4, 0.0)
    none = replace(shared, common=CommonBias(np.zeros((1, 1)), np.zeros((1, 1))))
    e, alone = correlated(none, theta, coordinates)[0], partitioned(tests, theta, coordinates)[0]
    np.testing.assert_allclose(e.nll, alone.nll, rtol=1e-12)
    np.testing.assert_allclose(e.gradient, alone.gradient, rtol=1e-9, atol=1e-10)


def biased_manipulator(count, walk, seed=1, s=0.3):
    """The manipulator with a sensor bias: constant, or a random walk from test to test."""
    rng = np.random.default_rng(seed)
    c, recordings = s * rng.normal(), []
    for recording in simulate_markov_tests(count, seed, 60):
        recordings.append(replace(recording, y=recording.y + c))
        c += np.sqrt(walk) * rng.normal()
    family, maps = with_output_bias(markov_matrices, (INITIAL_STATE_MAP,) * count, np.ones((1, 1)))
    return CrossSection(family, tuple(recordings), maps, CommonBias(np.array([[s**2]]), np.array([[walk]])))


def test_batch_tells_that_the_first_mean_stays_uncertain_by_the_bias():
    """A test sees b1 + c only: the error of mu1 cannot fall below that of a constant c, 0.3; mu2 is untouched."""
    errors = []
    for count in (10, 30):
        estimate = batch_ml(biased_manipulator(count, 0.0), START, Coordinates(2, 2))
        assert estimate.converged
        errors.append(estimate.standard_errors)
    assert 0.3 < errors[1][0] < errors[0][0]
    assert 0.45 < errors[1][1] / errors[0][1] < 0.75  # 1/sqrt(3) = 0.58, with estimated variances


def test_recursion_carries_the_bias_and_continues_to_the_last_bit(tmp_path):
    tests, coordinates = biased_manipulator(14, 0.01), Coordinates(2, 2)
    options = RecursiveOptions("literal", first=6)
    whole = recursive_ml(tests, START, coordinates, options).arrays()
    np.savez(tmp_path / "state.npz", **recursive_ml(tests.select(slice(10)), START, coordinates, options).arrays())
    with np.load(tmp_path / "state.npz") as file:
        state = RecursiveState.from_arrays(dict(file))
    later = continue_recursion(state, tests.select(slice(10, None))).arrays()
    for name, value in whole.items():
        assert value.tobytes() == later[name].tobytes(), name
    assert np.any(whole["carried_dmean"])
    batch = batch_ml(tests, START, coordinates)
    theta = coordinates.unpack(whole["vector"])
    assert np.all(np.abs(theta.mu - batch.theta.mu) < batch.standard_errors[:2])
    plain = CrossSection.common_map(markov_matrices, tests.recordings, INITIAL_STATE_MAP)
    with pytest.raises(EstimationError, match="carries 1 components of a common bias, the new tests have 0"):
        continue_recursion(state, plain)


def test_messages():
    tests, shared, _, theta, coordinates = sharing(6, 0.1)
    with pytest.raises(ModelError, match="share no bias"):
        correlated(tests, theta, coordinates, Carried.before_all(None, coordinates.size))
    with pytest.raises(EstimationError, match="partitioned method only"):
        batch_ml(shared, theta, coordinates, BatchOptions(evaluator="full"))
    with pytest.raises(EstimationError, match="for independent tests; with a common bias take literal"):
        recursive_ml(shared, theta, coordinates, RecursiveOptions("refresh", first=3))

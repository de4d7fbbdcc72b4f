"""Partitioned, full and dense evaluation of a test agree: likelihood, gradient and information."""

import numpy as np
import pytest
from dense_cross_section import dense_evaluation, random_tests

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.cross_sectional.evaluate import full, partitioned
from noiseid_cli.estimators.cross_sectional.ignorant import ignorant_filter, statistics
from noiseid_cli.estimators.cross_sectional.problem import Coordinates, CrossSection, Theta
from tests.oracles.markov import (
    INITIAL_STATE_MAP,
    TRUE_ALPHA,
    TRUE_COVARIANCE,
    TRUE_MEAN,
    markov_matrices,
)
from tests.oracles.markov_tests import simulate_markov_tests

CASES = [
    {"seed": 1},
    {"seed": 2, "structure": "diagonal"},
    {"seed": 3, "missing": 0.0, "varying": False},
    {"seed": 4, "nb": 4, "ny": 1, "nu": 2},
    {"seed": 5, "nb": 1, "na": 1, "ny": 3},
    {"seed": 9, "nu": 0, "na": 3},
    {"seed": 6, "lengths": (1, 2, 3), "nb": 4},  # too short to determine b
]


def scaled_difference(got, expected):
    """Largest difference of two matrices in units of the expected diagonal."""
    scale = np.sqrt(np.diagonal(expected, axis1=-2, axis2=-1))
    return np.max(np.abs(got - expected) / (scale[..., :, None] * scale[..., None, :] + 1e-300))


def manipulator(tests=3, samples=200, seed=7):
    recordings = simulate_markov_tests(tests, seed, samples)
    return CrossSection.common_map(markov_matrices, recordings, INITIAL_STATE_MAP)


@pytest.mark.parametrize("case", CASES)
def test_partitioned_and_full_equal_the_dense_gaussian(case):
    tests, theta, coordinates = random_tests(**case)
    by_parts, whole = partitioned(tests, theta, coordinates)[0], full(tests, theta, coordinates)
    for i in range(len(tests)):
        nll, gradient, fisher = dense_evaluation(tests, i, theta, coordinates)
        np.testing.assert_allclose([by_parts.nll[i], whole.nll[i]], nll, rtol=1e-11, atol=1e-11)
        np.testing.assert_allclose(by_parts.gradient[i], gradient, rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(whole.gradient[i], gradient, rtol=1e-10, atol=1e-10)
        # All blocks but alpha-alpha are exact expectations; (30) is one only on average over the data.
        n = coordinates.n_beta
        got = by_parts.information[i].copy()
        got[n:, n:] = fisher[n:, n:]
        assert scaled_difference(got, fisher) < 1e-10
        np.testing.assert_allclose(by_parts.information[i, n:, n:], whole.information[i, n:, n:], rtol=1e-9)


def test_the_exact_cross_blocks_matter_on_a_model_whose_initial_response_depends_on_alpha():
    tests, theta, coordinates = random_tests(seed=1)
    n, nb = coordinates.n_beta, coordinates.nb
    fisher = dense_evaluation(tests, 0, theta, coordinates)[2]
    scale = np.sqrt(np.outer(np.diag(fisher), np.diag(fisher)))
    assert np.max(np.abs(fisher / scale)[n:, :nb]) > 0.01  # (39) says zero


def test_likelihood_in_the_papers_form_34_equals_26():
    tests, theta, coordinates = random_tests(seed=3, missing=0.0)
    whole = full(tests, theta, coordinates)
    for i, (recording, T) in enumerate(zip(tests.recordings, tests.maps, strict=True)):
        s = statistics(ignorant_filter(tests.matrices(i, theta.alpha), [recording], T))
        gram = s.gram[0]
        P = np.linalg.inv(gram[1:, 1:])
        b = P @ gram[1:, 0]
        r, S = b - theta.mu, theta.Sigma + P
        nll = 0.5 * (
            np.linalg.slogdet(S)[1] + r @ np.linalg.solve(S, r)
            - np.linalg.slogdet(P)[1] - b @ np.linalg.solve(P, b) + gram[0, 0] + s.logdet[0]
        )  # fmt: skip
        np.testing.assert_allclose(nll, whole.nll[i], rtol=1e-10)


@pytest.mark.parametrize(
    "Sigma", [TRUE_COVARIANCE, np.array([[1.0, 0.3], [0.3, 0.25]]), np.diag([1.0, 0.0]), np.zeros((2, 2))]
)
def test_manipulator_of_200_samples(Sigma):
    tests, theta, coordinates = manipulator(), Theta(TRUE_MEAN, Sigma, TRUE_ALPHA), Coordinates(2, 2, "full")
    by_parts, whole = partitioned(tests, theta, coordinates)[0], full(tests, theta, coordinates)
    np.testing.assert_allclose(by_parts.nll, whole.nll, rtol=1e-10)
    assert np.max(np.abs(by_parts.gradient - whole.gradient) / (1 + np.abs(whole.gradient))) < 1e-8
    np.testing.assert_allclose(by_parts.information[:, -2:, -2:], whole.information[:, -2:, -2:], rtol=1e-9)


def test_a_test_without_measurements_says_nothing():
    tests, theta, coordinates = random_tests(seed=8, lengths=(5,))
    tests.recordings[0].y[:] = np.nan
    for result in (partitioned(tests, theta, coordinates)[0], full(tests, theta, coordinates)):
        assert result.nll[0] == 0.0
        assert not np.any(result.gradient)
        assert not np.any(result.information)


def test_an_output_known_exactly_is_told_with_its_sample():
    tests, theta, coordinates = random_tests(seed=3, missing=0.0)
    for name in ("R", "Q", "S_a"):
        tests.family.base[name][:] = 0.0
        tests.family.slope[name][:] = 0.0
    with pytest.raises(EstimationError, match="'test-0': the innovation covariance at sample 1 of 15"):
        partitioned(tests, theta, coordinates)

"""Expected information: the dense Gaussian's own, the mean of the observed one, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest
from dense_gaussian import dense_outputs
from pendulum import pendulum_case
from random_models import random_case

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.expected_information import cramer_rao, expected_information
from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.estimators.unknowns import Unknowns
from noiseid_cli.models.linear import linear_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording


def dense_information(case, unknowns):
    """1/2 tr(W S_a W S_b) + m_a' W m_b of the stacked outputs; S is linear in Q, R and P0, m in m0."""
    noise, scale = case.noise, unknowns.mean_scale(case.noise)
    total = 0.0
    for i, recording in enumerate(case.recordings):
        model = (case.A, case.B, case.G, case.C, case.D, recording)
        values = {"Q": noise.Q, "R": noise.R, "P0": noise.P0}
        mean, cov = dense_outputs(*model, **values, m0=noise.m0[i])
        slopes, means = [], []
        for letter, structure, (value,) in unknowns.covariances(noise):
            for direction in structure.jacobian(structure.coordinates(value)):
                moved = values | {letter: value + direction}
                slopes.append(dense_outputs(*model, **moved, m0=noise.m0[i])[1] - cov)
                means.append(np.zeros(len(mean)))
        if unknowns.m0:
            for j in range(len(scale)):
                moved = noise.m0[i] + scale[j] * np.eye(len(scale))[j]
                means.append(dense_outputs(*model, **values, m0=moved)[0] - mean)
                slopes.append(np.zeros_like(cov))
        W = np.linalg.inv(cov)
        turned = np.array([W @ s for s in slopes])
        total = total + 0.5 * np.einsum("aij,bji->ab", turned, turned) + np.array(means) @ W @ np.array(means).T
    return total


@pytest.mark.parametrize("seed", range(4))
def test_it_is_that_of_the_dense_gaussian(seed):
    case = random_case(seed, 3, 2, 2, lengths=(12, 7), missing=0.25)
    noise = case.noise
    unknowns = Unknowns(
        Q=CovarianceStructure.full(noise.Q),
        R=CovarianceStructure.scaled(noise.R) if seed == 0 else CovarianceStructure.full(noise.R),
        P0=CovarianceStructure.full(noise.P0) if seed == 1 else None,
        m0=seed > 0,
    )
    found = expected_information(case.model, case.recordings, noise, unknowns).matrix
    assert np.allclose(found, dense_information(case, unknowns), rtol=1e-8, atol=1e-8 * np.max(found))


def test_the_bound_of_a_mean_square_is_the_textbooks():
    """White noise alone, n values: the standard error of its standard deviation s is s / sqrt(2 n)."""
    n, s = 50, 3.0
    model = linear_model(A=[[0.0]], G=[[0.0]], C=[[1.0]])
    y = np.zeros((n, 1))
    y[:10] = np.nan
    noise = NoiseValues(np.eye(1), np.array([[s * s]]), np.zeros((1, 1)), np.zeros((1, 1)))
    unknowns = Unknowns(R=CovarianceStructure.diagonal(noise.R))
    bound = cramer_rao(model, [Recording("a", np.ones(n - 1), np.zeros((n, 0)), y)], noise, unknowns)
    assert bound == {("measurement_noise_std", "y1"): pytest.approx(s / np.sqrt(2 * (n - 10)), rel=1e-12)}


def test_what_the_data_do_not_determine_has_no_bound():
    """Two noises that enter as one: their correlation and their shares leave no trace in the outputs."""
    model = linear_model(A=[[0.5]], G=[[1.0, 1.0]], C=[[1.0]])
    noise = NoiseValues(np.diag([1.0, 2.0]), np.eye(1), np.zeros((1, 1)), np.eye(1))
    unknowns = Unknowns(Q=CovarianceStructure.diagonal(noise.Q), R=CovarianceStructure.diagonal(noise.R))
    recording = Recording("a", np.ones(99), np.zeros((100, 0)), np.zeros((100, 1)))
    bound = cramer_rao(model, [recording], noise, unknowns)
    assert np.isnan(bound["process_noise_std", "v1"])
    assert np.isfinite(bound["measurement_noise_std", "y1"])


def test_refusals():
    case = random_case(5, 2, 2, 1)
    diagonal = Unknowns(Q=CovarianceStructure.diagonal(np.diag(np.diag(case.noise.Q))))
    with pytest.raises(EstimationError, match="the true Q does not have the structure"):
        expected_information(case.model, case.recordings, case.noise, diagonal)
    model, noise, recordings = pendulum_case(1, lengths=(20,))
    with pytest.raises(EstimationError, match="for linear models only"):
        expected_information(model, recordings, noise, Unknowns(Q=CovarianceStructure.full(noise.Q)))
    # A linear model with a first state that is exactly known is taken.
    known = replace(case.noise, P0=np.zeros_like(case.noise.P0))
    unknowns = Unknowns(R=CovarianceStructure.full(known.R))
    assert np.all(np.diag(expected_information(case.model, case.recordings, known, unknowns).matrix) > 0.0)

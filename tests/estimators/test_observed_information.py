"""Free coordinates, the gradient in them, and the observed information."""

from dataclasses import replace

import numpy as np
import pytest
from random_models import random_case

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.coordinates import Coordinates
from noiseid_cli.estimators.likelihood import Likelihood
from noiseid_cli.estimators.observed_information import information_at, marginal_information, observed_information
from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.estimators.unknowns import ParameterUnknowns, Unknowns
from noiseid_cli.models.linear import linear_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording

Q = np.array([[1.3, 0.4], [0.4, 1.3]])
STRUCTURES = {
    "full": CovarianceStructure.full(Q),
    "reordered block": CovarianceStructure(Q, ((1, 0),)),
    "diagonal": CovarianceStructure.diagonal(np.diag([1.0, 2.0])),
    "scale": CovarianceStructure.scaled(Q),
    "held": CovarianceStructure(Q, ((0, 1),), held=frozenset({(1, 1)})),
    "tied in a block": CovarianceStructure(Q, ((0, 1),), tied=((0, 1),)),
    "tied diagonal": CovarianceStructure(np.diag([1.3, 1.3]), ((0,), (1,)), tied=((0, 1),)),
}
FREE, OVER, UNDER, BETWEEN = (-np.inf, np.inf), (-5.0, np.inf), (-np.inf, 5.0), (-5.0, 6.0)


def coordinates(structure):
    """Everything unknown at once: Q of the structure, R, m0, P0, and a parameter with each kind of bounds."""
    case = random_case(3, 3, 2, 2, lengths=(25, 15), missing=0.2)
    P0 = np.diag(np.diag(case.noise.P0))
    noise = replace(case.noise, Q=structure.start, P0=P0, m0=np.tile(case.noise.m0[0], (2, 1)))
    R = CovarianceStructure.full(noise.R)
    unknowns = Unknowns(Q=structure, R=R, P0=CovarianceStructure.diagonal(P0), m0=True)
    at = (0, 4, 14, 21)
    lower, upper = np.array([FREE, OVER, UNDER, BETWEEN]).T
    parameters = ParameterUnknowns(("a", "b", "c", "d"), case.model.parameters[list(at)], lower, upper)
    return Coordinates(unknowns, noise, case.model, parameters, at), case.recordings


@pytest.mark.parametrize("name", STRUCTURES)
def test_gradient_in_free_coordinates_is_the_slope_of_the_likelihood(name):
    c, recordings = coordinates(STRUCTURES[name])
    exact, differences = Likelihood(c, recordings), Likelihood(c, recordings, "differences")
    z = c.pack(c.start, c.parameters.start)
    assert len(c.names) == z.size == len(set(c.names))
    rng = np.random.default_rng(0)
    moved = z + 0.1 * rng.normal(size=z.size)
    assert np.allclose(c.pack(c.unpack(moved)[0], c.values(moved)[0]), moved, rtol=0, atol=1e-12)
    a, b = exact.point(moved), differences.point(moved)
    assert a.loglik == b.loglik
    # A central difference with step 1e-4 errs by about 1e-8 of the third derivative.
    np.testing.assert_allclose(a.gradient, b.gradient, rtol=1e-6, atol=1e-6 * np.max(np.abs(a.gradient)))
    assert (exact.passes, differences.passes) == (1, 1 + 2 * z.size)


def test_information_is_the_curvature_of_the_likelihood():
    c, recordings = coordinates(STRUCTURES["full"])
    likelihood = Likelihood(c, recordings)
    z = c.pack(c.start, c.parameters.start)
    found = information_at(likelihood, z)
    assert likelihood.visited == []
    assert found.passes == likelihood.passes
    rng = np.random.default_rng(1)
    for _ in range(3):
        d = rng.normal(size=z.size)
        d /= np.linalg.norm(d)
        h = 1e-3
        values = [likelihood.value(z + s * h * d) for s in (-2, -1, 0, 1, 2)]
        second = np.dot(values, [-1, 16, -30, 16, -1]) / (12 * h * h)
        assert d @ found.matrix @ d == pytest.approx(-second, rel=1e-2, abs=0.02)


def test_information_of_a_constant_in_white_noise():
    """A fixed level in noise: N / r by the level, 2 N by the log standard deviation, no cross term."""
    rng = np.random.default_rng(5)
    y = 3.0 + 0.5 * rng.normal(size=(400, 1))
    model = linear_model(A=[[1.0]], G=[[1.0]], C=[[1.0]])
    m, r = np.full((1, 1), y.mean()), np.full((1, 1), y.var())
    noise = NoiseValues(np.zeros((1, 1)), r, m, np.zeros((1, 1)))
    unknowns = Unknowns(R=CovarianceStructure.diagonal(r), m0=True)
    found = observed_information(model, [Recording("a", np.ones(399), np.zeros((400, 0)), y)], noise, unknowns)
    # The mean's unit is 1 where the first state is exactly known.
    assert found.names == ("log std(y1)", "initial mean of x1, scaled")
    np.testing.assert_allclose(np.diag(found.matrix), [800.0, 400.0 / r[0, 0]], rtol=1e-3)
    assert abs(found.matrix[0, 1]) < 1e-3 * 800.0
    np.testing.assert_allclose(np.diag(found.covariance()), 1.0 / np.diag(found.matrix), rtol=1e-6)


def test_what_the_data_leaves_open_has_no_covariance():
    """A parameter that no output depends on: NaN for it, numbers for the rest."""
    rng = np.random.default_rng(6)
    model = linear_model(A=[[0.9, 0.0], [0.0, 0.5]], G=[[1.0], [0.0]], C=[[1.0, 0.0]])
    noise = NoiseValues(np.eye(1), np.eye(1), np.zeros((1, 2)), np.eye(2))
    recording = Recording("a", np.ones(99), np.zeros((100, 0)), rng.normal(size=(100, 1)))
    parameters = ParameterUnknowns(("idle",), np.array([0.5]), np.array([-np.inf]), np.array([np.inf]))
    unknowns = Unknowns(Q=CovarianceStructure.full(noise.Q))
    found = observed_information(model, [recording], noise, unknowns, parameters, at=[3])
    assert found.matrix[1, 1] == 0.0
    covariance = found.covariance()
    assert np.isnan(covariance[1]).all()
    assert covariance[0, 0] == pytest.approx(1.0 / found.matrix[0, 0])


def test_parameters_must_fit_the_model_and_their_bounds():
    c, _ = coordinates(STRUCTURES["full"])
    with pytest.raises(EstimationError, match="4 parameters are unknown and 1 places"):
        replace(c, at=(0,))
    with pytest.raises(EstimationError, match="start of the parameter b is not between"):
        replace(c, parameters=replace(c.parameters, lower=np.array([-np.inf, 9.0, -np.inf, -5.0])))


def test_tied_variances_have_one_value_in_the_m_step():
    S = np.array([[2.0, 0.3], [0.3, 4.0]])
    assert np.allclose(STRUCTURES["tied diagonal"].maximise(S, np.diag([1.3, 1.3])), np.diag([3.0, 3.0]))
    found = STRUCTURES["tied in a block"].maximise(S, Q)
    # Equal variances, free covariance: symmetric under exchange, so the mean of S and S exchanged.
    np.testing.assert_allclose(found, [[3.0, 0.3], [0.3, 3.0]], rtol=1e-10)


def test_ties_that_contradict_are_refused():
    with pytest.raises(EstimationError, match="held and tied"):
        CovarianceStructure(Q, ((0, 1),), held=frozenset({(1, 1)}), tied=((0, 1),)).check()
    with pytest.raises(EstimationError, match="start at one value"):
        CovarianceStructure(np.diag([1.0, 2.0]), ((0,), (1,)), tied=((0, 1),)).check()


def test_marginal_information_is_that_of_the_noise_where_parameters_are_unknown_too():
    """Its inverse is the noise's block of the inverse of all; steps that are given are taken."""
    c, recordings = coordinates(STRUCTURES["diagonal"])
    problem = (c.model, recordings, c.start, c.unknowns)
    # Entries of the input gain and of the feedthrough, in which the log-likelihood is a parabola.
    at, bounds = (9, 24), np.array([FREE, OVER]).T
    parameters = ParameterUnknowns(("b", "d"), c.model.parameters[list(at)], *bounds)
    c = replace(c, parameters=parameters, at=at)
    whole = observed_information(*problem, c.parameters, c.at).matrix
    own = marginal_information(*problem, c.parameters, c.at)
    d = len(own)
    assert d == len(whole) - 2
    np.testing.assert_allclose(np.linalg.inv(own), np.linalg.inv(whole)[:d, :d], rtol=1e-8)
    near = marginal_information(*problem, c.parameters, c.at, steps=np.full(d, 1e-3))
    assert not np.array_equal(near, own)
    np.testing.assert_allclose(near, own, rtol=1e-2, atol=1e-2 * np.max(np.abs(own)))
    held = marginal_information(*problem)
    np.testing.assert_allclose(held, whole[:d, :d], rtol=1e-6, atol=1e-6 * np.max(np.abs(whole)))

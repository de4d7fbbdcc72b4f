"""EM with unscented and cubature smoothers."""

import numpy as np
import pytest
import sympy
from pendulum import pendulum_case
from random_models import random_case
from textbook_unscented import textbook

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators import em
from noiseid_cli.estimators.em_statistics import e_step
from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.estimators.unknowns import Unknowns
from noiseid_cli.filters.sigma_points import cubature, unscented
from noiseid_cli.models import Model, Quantity
from noiseid_cli.models.compile import compile_model
from noiseid_cli.models.linear import linear_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording

ALL = np.zeros(2, dtype=np.int64)


def full(noise):
    return Unknowns(Q=CovarianceStructure.full(noise.Q), R=CovarianceStructure.full(noise.R))


@pytest.mark.parametrize("weights", [cubature(2), unscented(2, 1.0), unscented(2, 0.8, 2.5, 0.5)])
def test_moments_equal_the_textbook_form(weights):
    """Two tests; the gain of the noise depends on the state, so that its inverse is averaged as well."""
    model, noise, recordings = pendulum_case(7, lengths=(20, 31))
    twins = [textbook(model, r, noise, weights, i) for i, r in enumerate(recordings)]
    found = e_step(model, recordings, noise, block_of=ALL, weights=weights)
    vv = sum(t.moment_v * (r.samples - 1) for t, r in zip(twins, recordings, strict=True)) / found.steps
    ee = sum(t.moment_e * r.samples for t, r in zip(twins, recordings, strict=True)) / found.samples[0]
    assert np.allclose(found.moment_v, vv, rtol=1e-9)
    assert np.allclose(found.moment_e, ee, rtol=1e-9)
    assert found.loglik == pytest.approx(sum(t.loglik for t in twins), abs=1e-8)
    assert np.allclose(found.m_first, [t.m[0] for t in twins], rtol=0, atol=1e-9)


@pytest.mark.parametrize("options", [{"smoother": "cubature"}, {"smoother": "unscented", "kappa": 0.0, "alpha": 0.7}])
def test_on_a_linear_model_all_smoothers_end_at_the_same_estimate(options):
    case = random_case(11, 3, 2, 2, lengths=(25, 14), missing=0.25)
    passes = {"max_passes": 6, "acceleration": "none"}
    a = em.estimate(case.model, case.recordings, case.noise, full(case.noise), em.EmOptions(**passes))
    b = em.estimate(case.model, case.recordings, case.noise, full(case.noise), em.EmOptions(**passes, **options))
    assert np.allclose(a.trace["loglik"], b.trace["loglik"], rtol=0, atol=1e-10)
    assert np.allclose(a.final.Q, b.final.Q, rtol=0, atol=1e-10)
    assert np.allclose(a.final.R, b.final.R, rtol=0, atol=1e-10)


class Square(Model):
    """A random walk seen through a square."""

    name = "test_square"
    states = (Quantity("x", "1", "state"),)
    noises = (Quantity("v", "1", "noise"),)
    outputs = (Quantity("y", "1", "square"),)
    sample_time = 1.0
    discretisation = "discrete"

    def dynamics(self, x, u, v, p):
        return [x.x + v.v]

    def output(self, x, u, p):
        return [x.x**2 + sympy.Rational(1, 2)]


def test_moment_of_a_square_is_exact():
    """One state with n + kappa = 3 and beta = 0 is Gauss-Hermite: exact for E[(y - h(x))^2], h a square."""
    model = compile_model(Square())
    m, P = 0.7, 0.3
    noise = NoiseValues(np.eye(1), np.array([[1e12]]), np.array([[m]]), np.array([[P]]))
    y = 2.0
    test = Recording("one", np.empty(0), np.empty((1, 0)), np.array([[y]]))
    found = e_step(model, [test], noise, block_of=np.zeros(1, dtype=np.int64), weights=unscented(1, 1.0, 0.0, 2.0))
    # The measurement tells nothing, so x ~ N(m, P): E[r^2] = (y - 1/2 - m^2 - P)^2 + Var x^2.
    exact = (y - 0.5 - m**2 - P) ** 2 + 4 * m**2 * P + 2 * P**2
    assert found.moment_e[0, 0] == pytest.approx(exact, rel=1e-8)


def test_finds_the_noise_of_a_pendulum_through_missing_outputs():
    """Three tests of 300 samples: the scatter of a variance from 900 of them is 2 / sqrt(1800) = 4.7 % of the std."""
    model, truth, recordings = pendulum_case(1, lengths=(300, 300, 300), missing=0.2)
    start = NoiseValues(truth.Q * 100, truth.R * np.diag([0.1, 10.0]), truth.m0, truth.P0)
    unknowns = Unknowns(Q=CovarianceStructure.full(start.Q), R=CovarianceStructure.diagonal(start.R))
    result = em.estimate(model, recordings, start, unknowns, em.EmOptions(smoother="unscented"))
    assert result.status == "converged"
    assert result.settings["smoother"] == "unscented"
    assert result.settings["kappa"] == "3 - nx"
    assert "linearisation" not in result.settings
    assert np.sqrt(result.final.Q / truth.Q) == pytest.approx(1.0, abs=4 * 0.047)
    assert np.sqrt(np.diag(result.final.R) / np.diag(truth.R)) == pytest.approx(1.0, abs=4 * 0.047)


def test_dependent_noise_gains_are_refused():
    model = linear_model(A=np.eye(2), G=[[1.0, 2.0], [1.0, 2.0]], C=np.eye(2))
    test = Recording("a", np.ones(4), np.empty((5, 0)), np.zeros((5, 2)))
    noise = NoiseValues(np.eye(2), np.eye(2), np.zeros((1, 2)), np.eye(2))
    with pytest.raises(EstimationError, match="test 'a', sample 1: the columns of the noise gain F2 are linearly"):
        e_step(model, [test], noise, weights=cubature(2))


def test_filtered_linearisation_belongs_to_the_extended_smoother():
    case = random_case(0)
    with pytest.raises(EstimationError, match="belongs to the extended smoother"):
        em.estimate(
            case.model, case.recordings, case.noise, full(case.noise),
            em.EmOptions(smoother="cubature", linearisation="filtered"),
        )  # fmt: skip

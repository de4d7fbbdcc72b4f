"""Matrices of a linear model as functions of its parameters: against matrices by hand, and against differences."""

import numpy as np
import pytest
import sympy as sp

from noiseid_cli.errors import ModelError
from noiseid_cli.models.declarations import Parameter, Quantity
from noiseid_cli.models.equations import Model
from noiseid_cli.models.linear_family import LinearFamily
from noiseid_cli.models.recording import Recording
from noiseid_cli.models.registry import load_model
from tests.oracles.markov import markov_matrices

MATRICES = ("A", "B", "Q", "C", "D", "R", "S_a")
R = np.array([[0.0025]])


class Oscillator(Model):
    """A mass on a spring with a driven and a free noise; the output feels the input."""

    name = "oscillator"
    states = (Quantity("s", "m"), Quantity("w", "m/s"))
    inputs = (Quantity("force", "N"),)
    noises = (Quantity("push", "N"), Quantity("drift", "m/s"))
    outputs = (Quantity("y", "m"), Quantity("a", "m/s^2"))
    parameters = (Parameter("k", 2.0), Parameter("m", 0.5), Parameter("c", 0.3))
    sample_time = 0.1
    discretisation = "exact"

    def terms(self, x, u, p):
        from noiseid_cli.models.declarations import Terms

        t = Terms()
        t.rate = (u.force - p.k * x.s - p.c * x.w) / p.m
        return t

    def dynamics(self, x, u, v, p):
        return [x.w + v.drift, sp.Symbol("rate", real=True) + v.push / p.m]

    def output(self, x, u, p):
        return [x.s * p.k, sp.Symbol("rate", real=True)]


def blank(*dt, nu=1, ny=1):
    return Recording("blank", np.array(dt), np.zeros((len(dt) + 1, nu)), np.full((len(dt) + 1, ny), np.nan))


def test_the_manipulator_has_the_matrices_of_the_paper():
    family = LinearFamily(load_model("markov_manipulator"), ("q", "rate"), np.eye(1), R)
    alpha, recording = np.array([0.03, 0.07]), blank(1.0, 1.0, 0.5)
    mine, by_hand = family(alpha, recording), markov_matrices(alpha, recording)
    for name in (*MATRICES, *("d" + name for name in MATRICES)):
        np.testing.assert_allclose(getattr(mine, name), getattr(by_hand, name), rtol=1e-13, atol=1e-16)


@pytest.mark.parametrize("scheme", ["exact", "van_loan", "euler"])
def test_derivatives_in_parameters_and_variances_equal_differences(scheme):
    model = Oscillator()
    model.discretisation = scheme
    Q, measured = np.array([[2.0, 0.3], [0.3, 1.0]]), np.diag([0.5, 4.0])
    family = LinearFamily(model, ("m", "k"), Q, measured, process=(1,), measurement=(0, 1))
    recording, alpha, h = blank(0.1, 0.3, ny=2), family.start, 1e-6
    np.testing.assert_array_equal(alpha, [0.5, 2.0, 1.0, 0.5, 4.0])
    here = family(alpha, recording)
    for i in range(len(alpha)):
        step = h * np.eye(len(alpha))[i]
        plus, minus = family(alpha + step, recording), family(alpha - step, recording)
        for name in MATRICES:
            difference = (getattr(plus, name) - getattr(minus, name)) / (2 * h)
            np.testing.assert_allclose(getattr(here, "d" + name)[i], difference, rtol=1e-7, atol=1e-8)


def test_held_noise_and_white_noise_differ_by_what_they_are():
    """Over a short step white noise of density W has the covariance W dt, held noise of variance V has V dt^2."""
    family = LinearFamily(Oscillator(), (), np.eye(2), np.eye(2))
    white = Oscillator()
    white.discretisation = "van_loan"
    dt = 1e-6
    held = family(np.empty(0), blank(dt, ny=2)).Q[0]
    G = np.array([[0.0, 1.0], [2.0, 0.0]])
    np.testing.assert_allclose(held, dt**2 * G @ G.T, rtol=1e-4, atol=dt**2 * 1e-4)
    spread = LinearFamily(white, (), np.eye(2), np.eye(2))(np.empty(0), blank(dt, ny=2)).Q[0]
    np.testing.assert_allclose(spread, dt * G @ G.T, rtol=1e-4, atol=dt * 1e-4)


def test_models_that_are_not_linear_are_refused_in_words():
    class Pendulum(Oscillator):
        discretisation = "euler"

        def dynamics(self, x, u, v, p):
            return [x.w + v.drift, -sp.sin(x.s) + v.push]

    class Offset(Oscillator):
        def output(self, x, u, p):
            return [x.s + 1, x.w]

    for wrong, said in ((Pendulum, "not linear"), (Offset, "constant term")):
        with pytest.raises(ModelError, match=said):
            LinearFamily(wrong(), (), np.eye(2), np.eye(2))(np.empty(0), blank(0.1, ny=2))
    stepped = Oscillator()
    stepped.discretisation = "rk4"
    with pytest.raises(ModelError, match="not rk4"):
        LinearFamily(stepped, (), np.eye(2), np.eye(2))(np.empty(0), blank(0.1, ny=2))


def test_one_interval_makes_a_model_for_filters_and_several_do_not():
    family = LinearFamily(Oscillator(), (), np.eye(2), np.eye(2))
    compiled, Q = family.filter_model(np.empty(0), [blank(0.1, 0.1, ny=2), blank(0.1, ny=2)])
    m = family(np.empty(0), blank(0.1, ny=2))
    np.testing.assert_array_equal(compiled.parameters[:4].reshape(2, 2), m.A[0])
    np.testing.assert_array_equal(Q, m.Q[0])
    assert family.filter_model(np.empty(0), [blank(0.1, 0.2, ny=2)]) is None


@pytest.mark.parametrize("law", ["[[p.q]]", "[[0, 1, 0], [0, 0, 0], [0, 0, p.q]]", "7"])
def test_a_law_of_the_first_state_that_does_not_fit_is_refused(law):
    model = load_model("markov_manipulator")
    model.initial_covariance = lambda p: eval(law)
    with pytest.raises(ModelError, match="initial_covariance must"):
        model.initial_law()


def test_the_states_that_the_model_says_nothing_of():
    assert [q.name for q in load_model("markov_manipulator").free_first_states] == ["x1", "x2"]
    assert [q.name for q in Oscillator().free_first_states] == ["s", "w"]


def test_equal_constant_tests_share_their_matrices():
    family = LinearFamily(load_model("markov_manipulator"), ("q", "rate"), np.eye(1), R)
    first = family(family.start, blank(0.5, 0.5))
    assert family(family.start.copy(), blank(0.5, 0.5, 0.5)) is first
    assert not np.array_equal(family(family.start, blank(0.25)).A, first.A)
    assert not np.array_equal(family(2.0 * family.start, blank(0.5)).Q, first.Q)

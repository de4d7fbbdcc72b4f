"""Markov noise: the augmented equations, their step, and what EM makes of coloured model error."""

import math
from typing import ClassVar

import numpy as np
import pytest
import sympy as sp
from one_step import transition, workspace

from noiseid_cli.errors import ModelError
from noiseid_cli.estimators import em
from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.estimators.unknowns import Unknowns
from noiseid_cli.models import Model, Parameter, Quantity, Terms
from noiseid_cli.models.coloured import with_markov_noise
from noiseid_cli.models.compile import compile_model
from noiseid_cli.models.describe import describe
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording

DT, TAU = 0.02, 0.3


class Cart(Model):
    """A cart with two forces of noise, of which one acts through a term."""

    name = "test_cart"
    states = (Quantity("s", "m", "place"), Quantity("w", "m/s", "speed"))
    inputs = (Quantity("f", "N", "force"),)
    noises = (Quantity("v", "N", "unknown force"), Quantity("slip", "m/s", "slip"))
    outputs = (Quantity("y", "m", "place"),)
    parameters = (Parameter("d", 0.4, "1/s", "damping"),)
    performances = (Quantity("e", "1", "energy"),)
    sample_time = DT
    discretisation = "rk4"
    latex_names: ClassVar = {"w": r"\dot s"}

    def terms(self, x, u, p):
        t = Terms()
        t.drag = p.d * x.w
        return t

    def dynamics(self, x, u, v, p):
        drag = self.terms(x, u, p).drag
        return [x.w + v.slip, u.f + (1 + x.s**2) * v.v - drag]

    def output(self, x, u, p):
        return [x.s]

    def performance(self, x, u, p):
        return [x.w**2]


class Linear(Cart):
    """The same with a constant gain."""

    name = "test_linear_cart"

    def dynamics(self, x, u, v, p):
        return [x.w + v.slip, u.f + v.v - p.d * x.w]


def test_names_units_and_words():
    model = with_markov_noise(Cart(d=0.7), {"v": TAU})
    assert [q.name for q in model.states] == ["s", "w", "xi_v"]
    assert [(q.name, q.unit) for q in model.noises] == [("slip", "m/s"), ("w_v", "N/s")]
    assert model.values == {"d": 0.7, "tau_v": TAU}
    assert (model.states[2].unit, model.states[2].description) == ("N", "Markov process: unknown force")
    assert (model.sample_time, model.discretisation) == (DT, "rk4")
    description = describe(model)
    assert description.summary.endswith("The noise v is a first-order Markov process.")
    latex = {e.name: e.latex for e in description.equations}
    assert r"\xi_{\mathrm{v}}" in latex["w"]
    assert r"\dot s" in latex["w"]


def test_equations_are_those_written_by_hand():
    eq = with_markov_noise(Cart(), {"v": TAU}).equations()
    s, w, xi, tau, drive, slip, f, drag = (
        sp.Symbol(n, real=True) for n in ("s", "w", "xi_v", "tau_v", "w_v", "slip", "f", "drag")
    )
    hand = (w + slip, f + (1 + s**2) * xi - drag, -xi / tau + drive)
    assert all(sp.simplify(a - b) == 0 for a, b in zip(eq.dynamics, hand, strict=True))
    both = with_markov_noise(Cart(), {"v": TAU}, keep_white=True)
    assert [q.name for q in both.noises] == ["v", "slip", "w_v"]
    white = sp.Symbol("v", real=True)
    assert sp.simplify(both.equations().dynamics[1] - hand[1] - (1 + s**2) * white) == 0


def decay(discretisation):
    """(F, G) of the process itself over one interval."""
    own = Linear()
    own.discretisation = discretisation
    compiled = compile_model(with_markov_noise(own, {"v": TAU}))
    x_next, F, G = np.empty(3), np.empty((3, 3)), np.empty((3, 2))
    transition(
        compiled.scheme, compiled.drift_jacobian, np.array([0.1, 0.2, 0.3]), np.zeros(1), DT, compiled.parameters,
        x_next, F, G, workspace(3, 2),
    )  # fmt: skip
    return F[2, 2], G[2, 1]


@pytest.mark.parametrize("scheme", ["exact", "rk4"])
def test_the_process_decays_as_stated(scheme):
    h = DT / TAU
    error = h**5 / 120 * 1.01 if scheme == "rk4" else 1e-14
    a, b = decay(scheme)
    assert abs(a - math.exp(-h)) <= error
    assert abs(b - TAU * (1 - math.exp(-h))) <= TAU * error
    if scheme == "rk4":
        assert abs(a - math.exp(-h)) > h**5 / 120 / 2


class Discrete(Cart):
    """The next state of a cart."""

    name = "test_discrete_cart"
    discretisation = "discrete"

    def dynamics(self, x, u, v, p):
        return [x.s + DT * x.w + v.slip, x.w + DT * v.v]


def test_a_discrete_model_gets_the_exact_step_of_its_own_sample_time():
    own = Discrete()
    own.set_sample_time(2 * DT)
    step = with_markov_noise(own, {"v": TAU}).equations().dynamics[2]
    xi, w, tau = (sp.Symbol(n, real=True) for n in ("xi_v", "w_v", "tau_v"))
    h = 2 * DT / TAU
    assert float(step.diff(xi).subs(tau, TAU)) == pytest.approx(math.exp(-h), abs=1e-14)
    assert float(step.diff(w).subs(tau, TAU)) == pytest.approx(TAU * (1 - math.exp(-h)), abs=1e-14)


def test_euler_has_its_own_decay():
    assert decay("euler") == pytest.approx((1 - DT / TAU, DT), abs=1e-15)


@pytest.mark.parametrize(
    ("constants", "words"),
    [
        ({"b": 1.0}, "noise b is not known"),
        ({"v": 0.0}, "time constant of v is 0.0 s; it must be above 0"),
        ({}, "name at least one noise"),
    ],
)
def test_what_makes_no_process_is_refused(constants, words):
    with pytest.raises(ModelError, match=words):
        with_markov_noise(Cart(), constants)


def test_em_finds_the_intensity_and_the_likelihood_prefers_the_colour():
    """An order of magnitude of likelihood lies between the two on 1500 samples of a coloured force."""
    rng = np.random.default_rng(4)
    model = with_markov_noise(Linear(), {"v": TAU})
    plain, coloured = compile_model(Linear()), compile_model(model)
    N, q, r = 1500, 3.0, 1e-4
    x, y, work = np.zeros(3), np.empty((N, 1)), workspace(3, 2)
    x_next, F, G, none = np.empty(3), np.empty((3, 3)), np.empty((3, 2)), np.zeros(1)
    for k in range(N):
        y[k] = x[0] + r * rng.normal()
        transition(coloured.scheme, coloured.drift_jacobian, x, none, DT, coloured.parameters, x_next, F, G, work)
        x = x_next + G[:, 1] * q * rng.normal()
    recording = Recording("a", np.full(N - 1, DT), np.zeros((N, 1)), y)

    def run(compiled, Q, held):
        n = compiled.nx
        start = NoiseValues(np.diag(Q), np.array([[r**2]]), np.zeros((1, n)), 1e-6 * np.eye(n))
        free = CovarianceStructure(start.Q, ((0,), (1,)), held=frozenset({(held, held)}))
        return em.estimate(compiled, [recording], start, Unknowns(Q=free))

    white = run(plain, [1.0, 1e-12], 1)
    found = run(coloured, [1e-12, 1.0], 0)
    assert found.status == "converged"
    assert math.sqrt(found.final.Q[1, 1]) == pytest.approx(q, rel=0.1)
    assert found.loglik > white.loglik + 100

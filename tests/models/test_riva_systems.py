"""The one-link robot and the pendubot: printed numbers, Lagrange's equations, energy, noise per sample."""

import functools
import math

import numpy as np
import pytest
import sympy as sp
from one_step import transition, workspace
from scipy.integrate import solve_ivp

from noiseid_cli.errors import ModelError
from noiseid_cli.models import Model, Parameter, Quantity
from noiseid_cli.models.compile import compile_model
from noiseid_cli.models.registry import load_model

q1, q2, w1, w2, a1, a2 = sp.symbols("q1 q2 w1 w2 a1 a2")


def drift(compiled, x, u=(0.0,), v=None):
    dx = np.empty(compiled.nx)
    noise = np.zeros(compiled.nv) if v is None else np.asarray(v, dtype=float)
    compiled.drift(np.array(x, dtype=float), np.array(u, dtype=float), noise, compiled.parameters, dx)
    return dx


@functools.cache
def pendubot_energies():
    """Energies of two bodies whose masses, levers and inertias are written out, and their t1..t5."""
    m1, m2, l1, c1, c2, i1, i2, g = sp.symbols("m1 m2 l1 c1 c2 i1 i2 g", positive=True)
    s = q1 + q2
    first = (c1 * sp.cos(q1), c1 * sp.sin(q1))
    second = (l1 * sp.cos(q1) + c2 * sp.cos(s), l1 * sp.sin(q1) + c2 * sp.sin(s))

    def squared(point):
        return sum((sp.diff(c, q1) * w1 + sp.diff(c, q2) * w2) ** 2 for c in point)

    kinetic = (m1 * squared(first) + m2 * squared(second) + i1 * w1**2 + i2 * (w1 + w2) ** 2) / 2
    potential = g * (m1 * first[1] + m2 * second[1])
    minimal = {
        "t1": m1 * c1**2 + i1 + m2 * l1**2,
        "t2": m2 * c2**2 + i2,
        "t3": m2 * l1 * c2,
        "t4": m1 * c1 + m2 * l1,
        "t5": m2 * c2,
    }
    return kinetic, potential, minimal


BODY = {"m1": 1.3, "m2": 0.7, "l1": 0.5, "c1": 0.2, "c2": 0.3, "i1": 0.02, "i2": 0.01, "g": 9.7}


def with_body(expression):
    return sp.sympify(expression).subs({s: BODY[s.name] for s in expression.free_symbols if s.name in BODY})


def pendubot_of_body(**parameters):
    minimal = {name: float(with_body(value)) for name, value in pendubot_energies()[2].items()}
    return load_model("pendubot", {**minimal, "g": BODY["g"], **parameters})


def test_pendubot_obeys_lagrange_with_friction():
    """Bodies of my own: t1 to t5 must then be the paper's sums of their masses, levers and inertias."""
    kinetic, potential, _ = pendubot_energies()
    L = kinetic - potential
    torques = []
    for q, w in ((q1, w1), (q2, w2)):
        momentum = sp.diff(L, w)
        rate = sum(sp.diff(momentum, s) * r for s, r in ((q1, w1), (q2, w2), (w1, a1), (w2, a2)))
        torques.append(with_body(rate - sp.diff(L, q)))
    torque = sp.lambdify((q1, q2, w1, w2, a1, a2), torques)
    model = pendubot_of_body(mu_v1=0.2, mu_d=0.3, mu_v2=0.05, k=20)
    compiled = compile_model(model)
    rng = np.random.default_rng(1)
    for _ in range(100):
        (angle1, angle2, speed1, speed2), tau = rng.uniform(-3, 3, 4), rng.normal()
        dx = drift(compiled, [angle1, speed1, angle2, speed2], [tau])
        np.testing.assert_array_equal(dx[[0, 2]], [speed1, speed2])
        expected = [tau - 0.2 * speed1 - 0.3 * np.arctan(20 * speed1), -0.05 * speed2]
        found = torque(angle1, angle2, speed1, speed2, dx[1], dx[3])
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)


def integrate(compiled, x0, seconds):
    return solve_ivp(lambda _, x: drift(compiled, x), (0, seconds), x0, method="DOP853", rtol=1e-11, atol=1e-13).y.T


def test_pendubot_keeps_its_energy_without_friction():
    model = pendubot_of_body(mu_v1=0, mu_d=0, mu_v2=0)
    x = integrate(compile_model(model), [0.4, 0.0, -0.8, 1.0], 2.0)
    kinetic, potential, _ = pendubot_energies()
    T, V = (sp.lambdify((q1, w1, q2, w2), with_body(energy), "numpy")(*x.T) for energy in (kinetic, potential))
    assert np.ptp(T) > 1.0
    assert np.ptp(T + V) < 1e-8 * (np.ptp(T) + np.ptp(V))


def test_one_link_keeps_its_energy_without_friction():
    model = load_model("one_link", {"mu_v": 0, "mu_d": 0})
    x = integrate(compile_model(model), [2.0, 0.0], 2.0)
    p = model.values
    T, V = x[:, 1] ** 2 / (2 * p["inverse_inertia"]), -p["mal2"] * p["g"] / 2 * np.cos(x[:, 0])
    assert np.ptp(T) > 0.5
    assert np.ptp(T + V) < 1e-8 * (np.ptp(T) + np.ptp(V))


def test_one_link_is_the_printed_equation():
    """3.1 of the paper, with J = 0.0559 kg m^2; the acceleration that is measured is that of the state."""
    compiled = compile_model(load_model("one_link"))
    J, q, w, tau = 5.59e-2, 0.7, -1.3, 0.4
    expected = (tau - 0.05 * w - 0.27 * math.atan(10 * w) - 0.11 * 9.81 / 2 * math.sin(q)) / J
    np.testing.assert_allclose(drift(compiled, [q, w], [tau]), [w, expected], rtol=1e-14)
    y = np.empty(2)
    compiled.output(np.array([q, w]), np.array([tau]), compiled.parameters, y)
    np.testing.assert_allclose(y, [q, expected], rtol=1e-14)


def test_pendubot_has_the_printed_numbers_and_rests_hanging():
    model = load_model("pendubot")
    assert list(model.values.values()) == [0.339, 0.0667, 0.0812, 0.717, 0.146, 0.09, 0.226, 0.003, 10, 9.81, 2e-4]
    assert {p.name for p in model.parameters if p.source == "chosen"} == {"g"}
    hanging = drift(compile_model(model), [-np.pi / 2, 0, 0, 0])
    # The cosine of pi/2 as a double is 6e-17; gravity over inertia is some 30 / s^2.
    np.testing.assert_allclose(hanging, 0, atol=1e-14)


@pytest.mark.parametrize("name", ["one_link", "pendubot"])
@pytest.mark.parametrize("dt", [None, 1e-3])
def test_noise_is_added_once_per_sample_at_any_sample_time(name, dt):
    model = load_model(name)
    if dt is not None:
        model.set_sample_time(dt)
    compiled = compile_model(model)
    n, dt = compiled.nx, model.sample_time
    assert (compiled.nv, model.values["Ts"]) == (n, dt)
    x = np.random.default_rng(2).normal(size=n)
    x_next, F, G = np.empty(n), np.empty((n, n)), np.empty((n, n))
    work = workspace(n, n)
    transition(compiled.scheme, compiled.drift_jacobian, x, np.ones(1), dt, compiled.parameters, x_next, F, G, work)
    np.testing.assert_allclose(G, np.eye(n), rtol=1e-15, atol=0)
    np.testing.assert_allclose(x_next, x + dt * drift(compiled, x, [1.0]), rtol=1e-15)


def test_sample_time_and_its_parameter_go_together():
    model = load_model("one_link", {"Ts": 5e-4})
    assert model.sample_time == 5e-4
    model.set_sample_time(1e-3)
    assert (model.values["Ts"], model.vector[-1]) == (1e-3, 1e-3)
    assert [p.source for p in model.parameters_in_force if p.name == "Ts"] == ["given"]
    assert load_model("one_link").sample_time == 2e-4
    with pytest.raises(ModelError, match=r"one_link: sample_time is -1\.0 s; it must be above zero"):
        model.set_sample_time(-1.0)
    with pytest.raises(ModelError, match=r"one_link: sample_time is 0\.0 s"):
        load_model("one_link", {"Ts": 0.0})


class Sampled(Model):
    """An integrator whose equations need the sample time."""

    name = "sampled"
    states = (Quantity("x"),)
    noises = (Quantity("n"),)
    outputs = (Quantity("x"),)
    parameters = (Parameter("h", 0.5, "s", "sample time", "chosen"),)
    sample_time = 0.5
    sample_time_parameter = "h"
    discretisation = "euler"


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ({"sample_time_parameter": "hh"}, "sample_time_parameter hh is not known; did you mean h"),
        ({"sample_time": 0.25}, r"parameter h equals the sample time: give both the same default, not 0\.5 and 0\.25"),
    ],
)
def test_a_sample_time_parameter_that_does_not_fit(attributes, message):
    with pytest.raises(ModelError, match=message):
        type("Faulty", (Sampled,), attributes)()

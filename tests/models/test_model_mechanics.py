"""The mechanical systems against Lagrange's equations derived here, and their physical properties."""

import functools
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp

from noiseid_cli.models.compile import compile_model
from noiseid_cli.models.registry import load_model, load_model_file
from noiseid_cli.simulation.trajectory import SquarePath, arm_reference

CONFIGS = Path(__file__).parents[2] / "configs"
q1, q2, w1, w2, a1, a2 = sp.symbols("q1 q2 w1 w2 a1 a2")


def pendulum(**parameters):
    return load_model_file(CONFIGS / "double_pendulum.py", "DoublePendulum", parameters)


def robot(**parameters):
    return load_model("flexible_robot", parameters)


def lagrange(kinetic, potential):
    """Torques d/dt dL/dq' - dL/dq at given accelerations."""
    L = kinetic - potential
    torques = []
    for q, w in ((q1, w1), (q2, w2)):
        momentum = sp.diff(L, w)
        rate = sum(sp.diff(momentum, s) * r for s, r in ((q1, w1), (q2, w2), (w1, a1), (w2, a2)))
        torques.append(rate - sp.diff(L, q))
    return torques


def speed_squared(x, y):
    return sum(sum(sp.diff(c, q) * w for q, w in ((q1, w1), (q2, w2))) ** 2 for c in (x, y))


@functools.cache
def robot_energies():
    """Kinetic and potential energy of the two arms, with the parameters as symbols."""
    p = {name: sp.Symbol(name) for name in robot().values}
    s = q1 + q2
    c1 = (p["xi1"] * sp.sin(q1), p["xi1"] * sp.cos(q1))
    c2 = (p["l1"] * sp.sin(q1) + p["xi2"] * sp.cos(s), p["l1"] * sp.cos(q1) - p["xi2"] * sp.sin(s))
    kinetic = (p["m1"] * speed_squared(*c1) + p["m2"] * speed_squared(*c2)) / 2
    kinetic += (p["j1"] * w1**2 + p["j2"] * (w1 + w2) ** 2) / 2
    return kinetic, p["g"] * (p["m1"] * c1[1] + p["m2"] * c2[1])


@functools.cache
def pendulum_energies():
    """Energies of the double pendulum; y points up and the angles count from hanging."""
    p = {name: sp.Symbol(name) for name in pendulum().values}
    s = q1 + q2
    c1 = (p["r1"] * sp.sin(q1), -p["r1"] * sp.cos(q1))
    c2 = (p["l1"] * sp.sin(q1) + p["r2"] * sp.sin(s), -p["l1"] * sp.cos(q1) - p["r2"] * sp.cos(s))
    kinetic = (p["m1"] * speed_squared(*c1) + p["m2"] * speed_squared(*c2)) / 2
    about_centre = [p["I1"] - p["m1"] * p["r1"] ** 2, p["I2"] - p["m2"] * p["r2"] ** 2]
    kinetic += (about_centre[0] * w1**2 + about_centre[1] * (w1 + w2) ** 2) / 2
    kinetic += p["gear"] ** 2 * p["Ir"] * (w1**2 + w2**2) / 2
    return kinetic, p["g"] * (p["m1"] * c1[1] + p["m2"] * c2[1])


def function_of_motion(expression, model, names):
    """Numpy function of the named motion variables at the model's parameter values."""
    return sp.lambdify(names, sp.sympify(expression).subs(model.values), "numpy")


def drift(compiled, x, u, v):
    dx = np.empty(compiled.nx)
    compiled.drift(np.ascontiguousarray(x), u, v, compiled.parameters, dx)
    return dx


def spring(model, i, d):
    """Spring torque as the specification prints it, and its energy."""
    k_low, k_high, psi = (model.values[f"{name}{i}"] for name in ("k_low", "k_high", "psi"))
    k3 = (k_high - k_low) / (3 * psi**2)
    beyond = max(abs(d) - psi, 0.0)
    inner = min(abs(d), psi)
    torque = np.sign(d) * (k_low * inner + k3 * inner**3 + k_high * beyond)
    energy = k_low * inner**2 / 2 + k3 * inner**4 / 4
    return torque, energy + (k_low * psi + k3 * psi**3) * beyond + k_high * beyond**2 / 2


def robot_friction(model, i, w):
    f_d, f_c, mu, alpha, beta = (model.values[f"{n}{i}"] for n in ("f_d", "f_c", "mu_k", "alpha", "beta"))
    return -(f_d * w + f_c * (mu + (1 - mu) / np.cosh(beta * w)) * np.tanh(alpha * w))


def test_robot_arms_obey_lagrange_and_motors_newton():
    model = robot(g=9.7, xi1=0.4)
    compiled = compile_model(model)
    torque = function_of_motion(sp.Matrix(lagrange(*robot_energies())), model, (q1, q2, w1, w2, a1, a2))
    rng = np.random.default_rng(3)
    for _ in range(200):
        qa, w = rng.uniform(-2, 2, 2), rng.normal(size=4)
        qm = qa + rng.uniform(-3, 3, 2) * model.values["psi1"]
        u, v = rng.normal(scale=500, size=2), rng.normal(scale=100, size=4)
        dx = drift(compiled, np.concatenate([qa, qm, w]), u, v)
        np.testing.assert_array_equal(dx[:4], w)
        gearbox = np.array(
            [model.values[f"d{i}"] * (w[i - 1] - w[i + 1]) + spring(model, i, qa[i - 1] - qm[i - 1])[0] for i in (1, 2)]
        )
        arms = torque(*qa, *w[:2], *dx[4:6]).ravel()
        scale = np.abs(gearbox).max() + np.abs(arms).max()
        np.testing.assert_allclose(arms, v[:2] - gearbox, rtol=0, atol=1e-11 * scale)
        for i in (1, 2):
            motor = gearbox[i - 1] + robot_friction(model, i, w[i + 1]) + u[i - 1] + v[i + 1]
            assert model.values[f"jm{i}"] * dx[5 + i] == pytest.approx(motor, abs=1e-11 * scale)


def test_robot_terms_are_the_matrices_of_lagrange():
    kinetic, potential = robot_energies()
    equations = robot().equations()
    rename = {"q1": "qa1", "q2": "qa2", "w1": "dqa1", "w2": "dqa2"}

    def own(name):
        term = sp.Symbol(name, real=True)
        expression = equations.terms[term]
        while used := expression.free_symbols & equations.terms.keys():
            expression = expression.subs({s: equations.terms[s] for s in used})
        return expression

    def derived(expression):
        return expression.subs(
            {s: sp.Symbol(rename.get(s.name, s.name), real=True) for s in sp.sympify(expression).free_symbols}
        )

    torques = [t.subs({a1: 0, a2: 0}) for t in lagrange(kinetic, potential)]
    resting = [t.subs({w1: 0, w2: 0}) for t in torques]
    expected = {
        "J11": sp.diff(kinetic, w1, 2),
        "J12": sp.diff(kinetic, w1, w2),
        "J22": sp.diff(kinetic, w2, 2),
        "G1": resting[0],
        "G2": resting[1],
        "C1": torques[0] - resting[0],
        "C2": torques[1] - resting[1],
    }
    for name, expression in expected.items():
        assert sp.simplify(own(name) - derived(expression)) == 0, name


def test_accelerometer_is_the_tools_acceleration_with_gravity():
    """Second derivative of the performance output along the motion, turned into the axes of arm 2."""
    model = robot()
    compiled = compile_model(model)
    rng = np.random.default_rng(4)
    for _ in range(50):
        x, u = rng.normal(size=8), rng.normal(size=2)
        x[2:4] = x[:2] + rng.uniform(-2e-3, 2e-3, 2)
        dx = drift(compiled, x, u, np.zeros(4))

        def tool(h, x=x, dx=dx):
            moved, z = x.copy(), np.empty(2)
            moved[:2] += h * x[4:6] + h**2 / 2 * dx[4:6]
            compiled.performance(moved, np.zeros(2), compiled.parameters, z)
            return z

        h = 1e-3 / (1 + np.abs(dx[4:6]).max())
        second = (-tool(-2 * h) + 16 * tool(-h) - 30 * tool(0) + 16 * tool(h) - tool(2 * h)) / (12 * h**2)
        s, y = x[0] + x[1], np.empty(4)
        compiled.output(x, u, compiled.parameters, y)
        turn = np.array([[np.cos(s), -np.sin(s)], [np.sin(s), np.cos(s)]])
        expected = turn @ (second + np.array([0, model.values["g"]]))
        # rounding of the difference: a few eps / h^2
        np.testing.assert_allclose(y[2:], expected, rtol=0, atol=1e-14 / h**2)
        np.testing.assert_array_equal(y[:2], x[2:4])


@pytest.mark.parametrize("joint", [1, 2])
def test_spring_is_continuous_with_its_slope_at_psi(joint):
    model = robot()
    compiled = compile_model(model)
    psi, jm = model.values[f"psi{joint}"], model.values[f"jm{joint}"]

    def torque_and_stiffness(d):
        x, f, A, B = np.zeros(8), np.empty(8), np.empty((8, 8)), np.empty((8, 4))
        x[joint + 1] = -d
        compiled.drift_jacobian(x, np.zeros(2), compiled.parameters, f, A, B)
        return jm * f[joint + 5], -jm * A[joint + 5, joint + 1]

    assert torque_and_stiffness(0.0) == (0.0, pytest.approx(model.values[f"k_low{joint}"], rel=1e-14))
    for sign in (1, -1):
        below, above = (torque_and_stiffness(sign * psi * (1 + e)) for e in (-1e-12, 1e-12))
        assert above == pytest.approx(below, rel=1e-11)
        assert above[1] == pytest.approx(model.values[f"k_high{joint}"], rel=1e-11)
        assert above[0] == pytest.approx(spring(model, joint, sign * psi)[0], rel=1e-11)


def integrate(compiled, x0, seconds):
    zero_u, zero_v = np.zeros(compiled.nu), np.zeros(compiled.nv)
    return solve_ivp(
        lambda _, x: drift(compiled, x, zero_u, zero_v), (0, seconds), x0, method="DOP853", rtol=1e-11, atol=1e-13
    ).y.T


def assert_energy_kept(kinetic, potential):
    """The solver's error per step is 1e-11 of the state; over some hundred steps the energy moves by 1e-8 at most."""
    total = kinetic + potential
    assert np.ptp(kinetic) > 0.1 * np.abs(total).max() or np.ptp(kinetic) > 1.0
    assert np.ptp(total) < 1e-8 * (np.ptp(kinetic) + np.ptp(potential))


def test_robot_keeps_its_energy_without_losses():
    none = dict.fromkeys([f"{name}{i}" for name in ("d", "f_d", "f_c") for i in (1, 2)], 0.0)
    model = robot(**none)
    x = integrate(compile_model(model), np.array([0.3, -0.1, 0.301, -0.1005, 0.5, 0.2, -0.5, 0.4]), 0.3)
    arms, gravity = (function_of_motion(e, model, (q1, q2, w1, w2)) for e in robot_energies())
    motion = (*x[:, 0:2].T, *x[:, 4:6].T)
    kinetic = arms(*motion) + (model.values["jm1"] * x[:, 6] ** 2 + model.values["jm2"] * x[:, 7] ** 2) / 2
    springs = np.array([sum(spring(model, i, row[i - 1] - row[i + 1])[1] for i in (1, 2)) for row in x])
    assert_energy_kept(kinetic, gravity(*motion) + springs)


def test_pendulum_keeps_its_energy_without_losses():
    model = pendulum(b1=0, b2=0, c1=0, c2=0)
    x = integrate(compile_model(model), np.array([2.0, 0.5, 0.0, 1.0]), 2.0)
    kinetic, potential = (function_of_motion(e, model, (q1, q2, w1, w2)) for e in pendulum_energies())
    assert_energy_kept(kinetic(*x.T), potential(*x.T))


def test_pendulum_obeys_lagrange_with_friction():
    model = pendulum(g=9.7, c2=0.1, sharpness=50)
    compiled = compile_model(model)
    torque = function_of_motion(sp.Matrix(lagrange(*pendulum_energies())), model, (q1, q2, w1, w2, a1, a2))
    rng = np.random.default_rng(5)
    p = model.values
    for _ in range(200):
        x, u, v = rng.uniform(-3, 3, 4), rng.normal(size=2), rng.normal(size=2)
        dx = drift(compiled, x, u, v)
        friction = np.array([p[f"b{i}"] * x[i + 1] + p[f"c{i}"] * np.arctan(50 * x[i + 1]) for i in (1, 2)])
        np.testing.assert_allclose(torque(*x, *dx[2:]).ravel(), u + v - friction, rtol=0, atol=1e-12)


def test_elastic_modes_along_the_square():
    """8.5 to 13.7 Hz with unloaded springs, 16.1 to 26.6 Hz with loaded ones; Euler's map is stable for all of them."""
    model = robot()
    compiled = compile_model(model)
    path = SquarePath(corner=(1.2, 0.7), side=0.2, side_time=0.5)
    poses, _, _ = arm_reference(path, np.linspace(0, 2, 41), model.values["l1"], model.values["l2"])
    for deflection, lowest, highest in ((0.0, 8.5, 13.7), (2 * model.values["psi1"], 16.1, 26.6)):
        frequencies = []
        for pose in poses:
            x = np.concatenate([pose, pose - deflection, np.zeros(4)])
            f, A, B = np.empty(8), np.empty((8, 8)), np.empty((8, 4))
            compiled.drift_jacobian(x, np.zeros(2), compiled.parameters, f, A, B)
            eigenvalues = np.linalg.eigvals(A)
            elastic = eigenvalues[np.abs(eigenvalues.imag) > 1]
            assert len(elastic) == 4
            assert np.abs(1 + model.sample_time * elastic).max() < 1
            frequencies += list(np.abs(elastic) / (2 * np.pi))
        assert min(frequencies) == pytest.approx(lowest, abs=0.05)
        assert max(frequencies) == pytest.approx(highest, abs=0.1)

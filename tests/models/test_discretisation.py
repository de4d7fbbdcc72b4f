"""The discrete map and its Jacobians, against differences and against the order of the method."""

import numpy as np
import pytest
import sympy as sp
from one_step import transition, workspace

from noiseid_cli.models import Model, Parameter, Quantity
from noiseid_cli.models.compile import compile_model
from noiseid_cli.models.equations import DISCRETISATIONS
from noiseid_cli.models.schemes import SCHEMES


class DrivenPendulum(Model):
    """Pendulum with a noise gain that depends on the state."""

    name = "driven_pendulum"
    states = (Quantity("q"), Quantity("w"))
    inputs = (Quantity("tau"),)
    noises = (Quantity("n1"), Quantity("n2"))
    outputs = (Quantity("q"),)
    parameters = (Parameter("a", 9.81), Parameter("b", 0.3))
    sample_time = 0.01
    discretisation = "rk4"

    def dynamics(self, x, u, v, p):
        return [x.w + 0.1 * v.n2, -p.a * sp.sin(x.q) - p.b * x.w + u.tau + (2 + sp.cos(x.q)) * v.n1]

    def output(self, x, u, p):
        return [x.q]


@pytest.fixture(scope="module")
def pendulum():
    return compile_model(DrivenPendulum())


def step(compiled, scheme, x, u, dt):
    n, nv = compiled.nx, compiled.nv
    x_next, F, G = np.full(n, np.nan), np.full((n, n), np.nan), np.full((n, nv), np.nan)
    work = workspace(n, nv)
    transition(scheme, compiled.drift_jacobian, x, u, dt, compiled.parameters, x_next, F, G, work)
    return x_next, F, G


def textbook_step(compiled, scheme, x, u, v, dt):
    """One step written as in a textbook, with the noise held over the interval."""

    def f(state):
        dx = np.empty(compiled.nx)
        compiled.drift(np.ascontiguousarray(state), u, v, compiled.parameters, dx)
        return dx

    if scheme == "discrete":
        return f(x)
    if scheme == "euler":
        return x + dt * f(x)
    k1 = f(x)
    k2 = f(x + dt / 2 * k1)
    k3 = f(x + dt / 2 * k2)
    k4 = f(x + dt * k3)
    return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def test_schemes_are_those_that_models_may_name():
    assert set(SCHEMES) == set(DISCRETISATIONS)


# The pendulum is not linear: for the exact schemes see test_exact_discretisation.py.
@pytest.mark.parametrize("scheme", sorted(set(SCHEMES) - {"exact", "van_loan"}))
def test_step_and_jacobians_equal_the_textbook_step_and_its_differences(pendulum, scheme):
    rng = np.random.default_rng(2)
    h = 1e-3

    def slope(function, size):
        """Central differences of sixth order: error about h^6 = 1e-18, rounding about 1e-16 / h = 1e-13."""
        columns = []
        for e in np.eye(size) * h:
            d1, d2, d3 = (function(k * e) - function(-k * e) for k in (1, 2, 3))
            columns.append((45 * d1 - 9 * d2 + d3) / (60 * h))
        return np.column_stack(columns)

    for _ in range(20):
        x, u, zero = rng.normal(size=2), rng.normal(size=1), np.zeros(2)
        x_next, F, G = step(pendulum, SCHEMES[scheme], x, u, 0.05)
        np.testing.assert_allclose(x_next, textbook_step(pendulum, scheme, x, u, zero, 0.05), rtol=0, atol=1e-14)
        by_x = slope(lambda d, x=x, u=u: textbook_step(pendulum, scheme, x + d, u, np.zeros(2), 0.05), 2)
        by_v = slope(lambda d, x=x, u=u: textbook_step(pendulum, scheme, x, u, d, 0.05), 2)
        np.testing.assert_allclose(F, by_x, rtol=0, atol=1e-11)
        np.testing.assert_allclose(G, by_v, rtol=0, atol=1e-11)


@pytest.mark.parametrize(("scheme", "order"), [("euler", 1), ("rk4", 4)])
def test_order_of_convergence(pendulum, scheme, order):
    """Halving the step divides the error at a fixed time by 2^order."""

    def end(steps):
        x = np.array([1.0, -0.5])
        for _ in range(steps):
            x = step(pendulum, SCHEMES[scheme], x, np.array([0.7]), 1.0 / steps)[0]
        return x

    exact = end(4096) if scheme == "rk4" else end(2**15)
    errors = [np.linalg.norm(end(n) - exact) for n in (32, 64)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.1)

"""Parameters and noise gains moved into the state: the stacked Jacobians are those of the model."""

import numpy as np
import pytest
from one_step import transition, workspace
from pendulum import Pendulum

from noiseid_cli.errors import ModelError
from noiseid_cli.models import Model, Parameter, Quantity
from noiseid_cli.models.compile import compile_model
from noiseid_cli.models.discretisation import advance
from noiseid_cli.models.stacked import stack_gains, stack_parameters


class Discrete(Model):
    """A nonlinear map whose gain depends on state and parameter, through a term."""

    name = "test_stacked_discrete"
    states = (Quantity("a"), Quantity("b"))
    inputs = (Quantity("r"),)
    noises = (Quantity("va"), Quantity("vb"))
    outputs = (Quantity("s"),)
    parameters = (Parameter("c", 0.7), Parameter("d", 1.3))
    sample_time = 1.0
    discretisation = "discrete"

    def terms(self, x, u, p):
        from noiseid_cli.models.declarations import Terms

        t = Terms()
        t.m = p.c * x.a
        return t

    def dynamics(self, x, u, v, p):
        t = self.terms(x, u, p)
        return [0.9 * x.a + u.r + t.m * x.b * v.va, p.d * x.b**2 / 5 + v.vb + t.m]

    def output(self, x, u, p):
        return [p.c * x.a * x.b]


def step(compiled, x, u, p, dt=0.04):
    n, nv = compiled.nx, compiled.nv
    x_next, F, G = np.empty(n), np.empty((n, n)), np.empty((n, nv))
    transition(compiled.scheme, compiled.drift_jacobian, x, u, dt, p, x_next, F, G, workspace(n, nv))
    return x_next, F, G


class EulerPendulum(Pendulum):
    name = "test_euler_pendulum"
    discretisation = "euler"


CASES = [(Pendulum(g=8.0), ["g", "c"]), (EulerPendulum(), ["c"]), (Discrete(), ["d", "c"])]


@pytest.mark.parametrize(("model", "names"), CASES)
def test_stacked_step_and_its_parameter_derivative(model, names):
    own, stacked = compile_model(model), compile_model(stack_parameters(model, names))
    x, u = np.array([0.4, -0.8]), np.array([0.3])
    theta = np.array([model.values[name] for name in names])
    z_next, F, G = step(stacked, np.concatenate((x, theta)), u, stacked.parameters)
    x_next, F_own, G_own = step(own, x, u, own.parameters)
    assert z_next == pytest.approx(np.concatenate((x_next, theta)), rel=1e-14)
    assert F[:2, :2] == pytest.approx(F_own, rel=1e-13)
    assert G[:2] == pytest.approx(G_own, rel=1e-13)
    assert not G[2:].any()
    for j, name in enumerate(names):
        at, h = list(model.values).index(name), 1e-6
        shift = h * np.eye(len(own.parameters))[at]
        slope = (step(own, x, u, own.parameters + shift)[0] - step(own, x, u, own.parameters - shift)[0]) / (2 * h)
        assert F[:2, 2 + j] == pytest.approx(slope, abs=1e-9)


@pytest.mark.parametrize(("model", "names"), CASES)
def test_gains_as_states_end_at_the_gain_and_give_its_derivative(model, names):
    stacked, gains = compile_model(stack_parameters(model, names)), compile_model(stack_gains(model, names))
    n, nv, nz = 2, stacked.nv, stacked.nx
    z, u = np.concatenate(([0.4, -0.8], [model.values[name] for name in names])), np.array([0.3])
    big, J, _ = step(gains, np.concatenate((z, np.zeros(n * nv))), u, gains.parameters)
    assert big[nz:].reshape(n, nv) == pytest.approx(step(stacked, z, u, stacked.parameters)[2][:n], rel=1e-13)
    for j in range(nz):
        h = 1e-6 * np.eye(nz)[j]
        up, down = (step(stacked, z + s * h, u, stacked.parameters)[2][:n] for s in (1, -1))
        assert J[nz:, j].reshape(n, nv) == pytest.approx((up - down) / 2e-6, abs=1e-9)


def test_a_constant_gain_needs_no_states():
    class Constant(EulerPendulum):
        name = "test_constant_gain"

        def dynamics(self, x, u, v, p):
            return [x.w, -p.g * x.q + p.c * v.v1]

    assert stack_gains(Constant(), ["g"]) is None
    assert stack_gains(Constant(), ["c"]) is not None


@pytest.mark.parametrize("model", [case[0] for case in CASES])
def test_a_step_without_jacobians_is_the_step_with_them(model):
    own = compile_model(model)
    x, u, x_next = np.array([0.4, -0.8]), np.array([0.3]), np.empty(2)
    advance(own.scheme, own.drift, x, u, np.zeros(own.nv), 0.04, own.parameters, x_next, np.empty(4))
    assert x_next == pytest.approx(step(own, x, u, own.parameters)[0], rel=1e-14)


def test_unknown_and_repeated_names_are_refused():
    with pytest.raises(ModelError, match="gg is not known"):
        stack_parameters(Pendulum(), ["gg"])
    with pytest.raises(ModelError, match="named twice"):
        stack_gains(Pendulum(), ["g", "g"])


def test_exact_discretisation_is_refused():
    class Linear(Model):
        name = "test_stacked_exact"
        states = (Quantity("a"),)
        noises = (Quantity("va"),)
        outputs = (Quantity("s"),)
        parameters = (Parameter("c", 0.7),)
        sample_time = 1.0
        discretisation = "exact"

        def dynamics(self, x, u, v, p):
            return [-p.c * x.a + v.va]

        def output(self, x, u, p):
            return [x.a]

    with pytest.raises(ModelError, match="use rk4"):
        stack_parameters(Linear(), ["c"])
    assert compile_model(stack_parameters(Linear(), [])).nx == 1
    assert stack_gains(Linear(), []) is None

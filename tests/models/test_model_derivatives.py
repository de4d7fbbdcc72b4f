"""Compiled values and derivatives against the sympy expressions evaluated on complex numbers."""

from pathlib import Path

import numpy as np
import pytest
import sympy as sp

from noiseid_cli.models.compile import compile_model
from noiseid_cli.models.registry import load_model, load_model_file

CONFIGS = Path(__file__).parents[2] / "configs"
POINTS = 200
STEP = 1e-30  # complex step: no difference is taken, so no digits are lost


def robot():
    return load_model("flexible_robot")


def pendulum():
    return load_model_file(CONFIGS / "double_pendulum.py", "DoublePendulum")


def random_points(model, rng):
    """States, inputs, noises and parameters; for the robot, deflections on both sides of psi."""
    x = rng.normal(size=(POINTS, len(model.states)))
    if model.name == "flexible_robot":
        x[:, 2:4] = x[:, 0:2] + rng.uniform(-3, 3, size=(POINTS, 2)) * model.values["psi1"]
    u = rng.normal(scale=100, size=(POINTS, len(model.inputs)))
    v = rng.normal(scale=10, size=(POINTS, len(model.noises)))
    p = model.vector * rng.uniform(0.9, 1.1, size=(POINTS, len(model.vector)))
    return {"x": x, "u": u, "v": v, "p": p}


class Oracle:
    """Evaluates the expressions on arrays of complex numbers, one term after the other."""

    def __init__(self, model):
        self.eq = model.equations()

    def __call__(self, expressions, points):
        values = {}
        for letter in "xuvp":
            columns = points[letter].T.astype(complex)
            values |= dict(zip(getattr(self.eq, letter), columns, strict=True))
        for term, definition in self.eq.terms.items():
            values[term] = self.evaluate(definition, values)
        return np.array([self.evaluate(e, values) for e in expressions]).T

    @staticmethod
    def evaluate(expression, values):
        names = sorted(expression.free_symbols, key=str)
        function = sp.lambdify(names, expression, modules=[{"sech": lambda z: 1 / np.cosh(z)}, "numpy"])
        result = function(*(values[s] for s in names))
        return np.broadcast_to(np.asarray(result, dtype=complex), (POINTS,))

    def jacobian(self, expressions, points, letter):
        columns = []
        for i in range(points[letter].shape[1]):
            moved = {k: a.astype(complex) for k, a in points.items()}
            moved[letter][:, i] += 1j * STEP
            columns.append(self(expressions, moved).imag / STEP)
        return np.stack(columns, axis=-1)


def assert_close(got, expected):
    """Each entry to 1e-10 of the largest value that it takes over the points."""
    scale = np.abs(expected).max(axis=0)
    assert np.isfinite(got).all()
    assert (np.abs(got - expected) <= 1e-10 * scale).all()


def call(function, inputs, shapes):
    outputs = [np.full(shape, np.nan) for shape in shapes]
    function(*inputs, *outputs)
    return outputs


def one_link():
    return load_model("one_link")


def pendubot():
    return load_model("pendubot")


@pytest.fixture(scope="module", params=[robot, pendulum, one_link, pendubot], ids=lambda make: make.__name__)
def case(request):
    model = request.param()
    return model, compile_model(model), Oracle(model), random_points(model, np.random.default_rng(1))


def test_drift_with_noise(case):
    _, compiled, oracle, points = case
    got = [call(compiled.drift, [points[c][k].copy() for c in "xuvp"], [compiled.nx])[0] for k in range(POINTS)]
    assert_close(np.array(got), oracle(oracle.eq.dynamics, points).real)


def test_drift_jacobian_holds_value_and_slopes_without_noise(case):
    _, compiled, oracle, points = case
    quiet = points | {"v": np.zeros_like(points["v"])}
    shapes = [compiled.nx, (compiled.nx, compiled.nx), (compiled.nx, compiled.nv)]
    got = [call(compiled.drift_jacobian, [points[c][k].copy() for c in "xup"], shapes) for k in range(POINTS)]
    f, A, B = (np.array(part) for part in zip(*got, strict=True))
    assert_close(f, oracle(oracle.eq.dynamics, quiet).real)
    assert_close(A, oracle.jacobian(oracle.eq.dynamics, quiet, "x"))
    assert_close(B, oracle.jacobian(oracle.eq.dynamics, quiet, "v"))


@pytest.mark.parametrize("which", ["output", "performance"])
def test_output_jacobian_holds_value_and_slope(case, which):
    _, compiled, oracle, points = case
    expressions = getattr(oracle.eq, which)
    if not expressions:
        assert getattr(compiled, which) is None
        assert getattr(compiled, which + "_jacobian") is None
        return
    m = len(expressions)
    value = oracle(expressions, points).real
    plain, pair = getattr(compiled, which), getattr(compiled, which + "_jacobian")
    got_plain = [call(plain, [points[c][k].copy() for c in "xup"], [m])[0] for k in range(POINTS)]
    got = [call(pair, [points[c][k].copy() for c in "xup"], [m, (m, compiled.nx)]) for k in range(POINTS)]
    assert_close(np.array(got_plain), value)
    assert_close(np.array([h for h, _ in got]), value)
    assert_close(np.array([H for _, H in got]), oracle.jacobian(expressions, points, "x"))


def test_friction_stays_finite_at_extreme_speeds():
    """1/cosh would give NaN slopes from |beta w| = 356 on; sech does not."""
    model = robot()
    compiled = compile_model(model)
    x = np.array([0.2, 0.1, 0.2, 0.1, 0.0, 0.0, 1e3, -1e3])
    f, A, _ = call(compiled.drift_jacobian, [x, np.zeros(2), compiled.parameters], [8, (8, 8), (8, 4)])
    assert np.isfinite(f).all()
    assert np.isfinite(A).all()
    slope = -(model.values["d1"] + model.values["f_d1"]) / model.values["jm1"]
    assert A[6, 6] == pytest.approx(slope, rel=1e-12)

"""Models of any shape and make before `noiseid check`: each is taken, or refused in a sentence; never a traceback.

In the suite some of each, in `make fuzz` many.
"""

import json

import pytest
from fuzz import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from noiseid_cli.app import app

COUNT = examples(60)
ODD = [
    *(None, True, "", [], {}, [[]], [1], [[1, 2], [3]], [[[1]]], {"name": "x1"}, {"name": "a", "unit": "\x1b[2J"}),
    *("a b", "1x", "lambda", "E", "pi", "S", "I", "zoo", "oo", "__class__", "_", "é", "ﬁ", "x'", "\u202e", "a" * 300),
    *("None", "True", "Ts", "t", "x1", "v1", "y1", "x1\nx2", "{{x}}", "tau_v1", "xi_v1", "\0", "~", "A.csv", "exact"),
    *(-1, 0, 1e300, -1e308, 5e-324, 1e-160, 10**19, 10**30, float("nan"), float("inf"), "1e400", ".nan", "van_loan"),
]
"""What is put in the place of something in a model."""


@st.composite
def linear_models(draw):
    """A model that is right, and its numbers of states, noises and outputs."""
    n, m, v, p = (draw(st.integers(low, 3)) for low in (1, 0, 1, 1))
    numbers = st.floats(-0.75, 0.75, width=16)
    shapes = {"A": (n, n), "B": (n, m), "G": (n, v), "C": (p, n), "D": (p, m)}
    if m == 0:
        del shapes["B"], shapes["D"]
    linear = {
        letter: [[draw(numbers) for _ in range(columns)] for _ in range(rows)]
        for letter, (rows, columns) in shapes.items()
    }
    linear["discretisation"] = draw(st.sampled_from(["discrete", "exact", "euler", "rk4"]))
    linear["sample_time"] = draw(st.sampled_from([1, 0.1, 1e-3]))
    for group, size in {"states": n, "inputs": m, "noises": v, "outputs": p}.items():
        if draw(st.booleans()):
            linear[group] = [{"name": f"{group[0]}{k}", "unit": "m"} if k else f"{group[0]}{k}" for k in range(size)]
    model = {"linear": linear}
    if draw(st.integers(0, 3)) == 0:
        linear["A"][0][0] = "a"
        model["parameters"] = {"a": 0.5}
    if draw(st.integers(0, 5)) == 0:
        name = linear["noises"][0] if "noises" in linear else "v1"
        model["markov_noise"] = {"on": [name], "time_constant": {name: 2.0}}
        n += 1
    return model, n, v, p


def places(node, path=()):
    """Where something stands in a document."""
    inside = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in inside:
        yield (*path, key)
        yield from places(value, (*path, key))


@st.composite
def spoilt(draw, models):
    """A model with something else in up to two places, or something taken away or put in twice."""
    model, *sizes = draw(models)
    for _ in range(draw(st.integers(0, 2))):
        *path, last = draw(st.sampled_from(list(places(model))))
        node = model
        for key in path:
            node = node[key]
        how = draw(st.integers(0, 5))
        if how == 0:
            del node[last]
        elif how == 1 and isinstance(node, list):
            node.insert(last, node[last])
        elif how == 2 and isinstance(node, dict):
            node[str(draw(st.sampled_from(ODD)))] = node.pop(last)
        else:
            node[last] = draw(st.sampled_from(ODD))
        if not list(places(model)):
            break
    return model, *sizes


def experiment(model, n=1, v=1, p=1):
    """The document around a model, with sizes that fit it."""
    return {
        "experiment": "fuzz",
        "model": model,
        "simulate": {
            "samples": 20,
            "trajectory": {"kind": "zero"},
            "process_noise": {"std": [1.0] * v},
            "measurement_noise": {"std": [1.0] * p},
        },
        "estimate": {
            "process_noise": {"start": {"std": [1.0] * v}},
            "measurement_noise": {"known": {"std": [1.0] * p}},
            "initial_mean": {"known": [0.0] * n},
            "initial_covariance": {"known": {"std": [1.0] * n}},
            "methods": {"em": {"max_passes": 2}},
        },
    }


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path


def outcome(folder, document, command="check"):
    """How a command ends on a document: 0, 2, 3 or 4, with a sentence where it refuses, and without a log of a bug."""
    text = json.dumps(document)  # JSON is YAML, and writes NaN and Infinity as no YAML number
    (folder / "noiseid.yaml").write_text(text)
    ended = CliRunner().invoke(app, command.split())
    assert ended.exit_code in (0, 2, 3, 4), (ended.exit_code, ended.stderr, text)
    assert "Traceback" not in ended.stderr
    assert ended.exit_code != 3 or ended.stderr.splitlines()[-1].startswith("noiseid: ")
    return ended


@settings(max_examples=COUNT)
@given(spoilt(linear_models()))
def test_linear_models_are_taken_or_refused(folder, tried, drawn):
    tried()
    outcome(folder, experiment(*drawn))


@settings(max_examples=examples(6, 40))
@given(linear_models())
def test_linear_models_of_any_shape_run(folder, tried, drawn):
    """From simulation to report: a status for each, whatever is not observed, not driven or measured twice."""
    tried()
    model, *sizes = drawn
    model["linear"]["A"][0] = [0.5 if entry == "a" else entry for entry in model["linear"]["A"][0]]
    model.pop("parameters", None)
    if model.pop("markov_noise", None):  # its time constant is a parameter: the equations would be compiled
        sizes[0] -= 1
    ended = outcome(folder, experiment(model, *sizes), "run -q --force")
    idle = ("are linearly dependent", "drives no state")
    assert ended.exit_code in (0, 4) or any(words in ended.stderr for words in idle)


SOURCE = """
from noiseid_cli.models import Model, Parameter, Quantity
import sympy as sp
import numpy as np


class Cart(Model):
    name = {name}
    states = {states}
    inputs = {inputs}
    noises = {noises}
    outputs = {outputs}
    parameters = {parameters}
    sample_time = {sample_time}
    discretisation = {discretisation}

    def dynamics(self, x, u, v, p):
        return {dynamics}

    def output(self, x, u, p):
        return {output}
"""
RIGHT = {
    "name": '"cart"',
    "states": '(Quantity("x", "m"), Quantity("w", "m/s"))',
    "inputs": '(Quantity("f", "N"),)',
    "noises": '(Quantity("v", "N"),)',
    "outputs": '(Quantity("x", "m"),)',
    "parameters": '(Parameter("k", 40.0), Parameter("m", 0.5))',
    "sample_time": "0.01",
    "discretisation": '"euler"',
    "dynamics": "[x.w, (u.f + v.v - p.k * x.x) / p.m]",
    "output": "[x.x]",
}
QUANTITIES = """\
()
None
3
"xw"
("x", "w")
(Quantity("x"), Quantity("x"))
(Quantity(""),)
(Quantity("lambda"), Quantity("w"))
(Quantity("1x"), Quantity("w"))
(Quantity(3),)
(Quantity("x y"), Quantity("w"))
(Quantity("E"), Quantity("w"))
[Quantity("x"), Quantity("w")]
(Quantity("x", 3), Quantity("w", None))
(Quantity("é"), Quantity("ﬁ"))
(Quantity,)
(Quantity("x\\n"), Quantity("w"))
(Quantity("t"), Quantity("w"))
(Quantity("_x"), Quantity("w"))
(Quantity("self"), Quantity("np"))
tuple(Quantity(f"x{k}") for k in range(100))
iter([])"""
PARAMETERS = """\
()
None
(Parameter("k", float("nan")), Parameter("m", 0.5))
(Parameter,)
(Parameter("k", "1"), Parameter("m", 0.5))
(Parameter("k", 1e400), Parameter("m", 0.5))
(Parameter("k", 1.0), Parameter("m", 0.0))
(Parameter("k", 1.0), Parameter("x", 1.0))
(Parameter("k", None), Parameter("m", True))
(Parameter("k", 1j), Parameter("m", 10**400))
(Parameter("", 1.0), Parameter("m", 0.5))
{"k": 1, "m": 2}"""
EQUATIONS = """\
[]
None
x.x
[x.w]
[x.w, 1, 2]
["x", "w"]
[None, None]
[x.w, v.v ** 2]
[x.w, v.v + sp.nan]
[x.w, v.v + sp.oo]
[x.w, v.v + float("nan")]
[x.w, v.v + sp.I * x.x]
[x.nosuch, x.w]
[x.w, v.v + u.f / 0]
[x.w, v.v + 1 / (x.x - x.x)]
[x.w, v.v + sp.Symbol("z")]
[x.w, v.v + sp.Function("g")(x.x)]
[x.w, v.v + sp.sign(x.x)]
[x.w, v.v + np.sin(x.x)]
[x.w, x.x > 0]
[x.w, sp.Matrix([[1]])]
1 / 0
[x.w, v.v + sp.Heaviside(x.x)]
[x.w, v.v + sp.floor(x.x)]
self.dynamics(x, u, v, p)
exit(3)
[x.w, v.v + sp.Integral(x.x, x.w)]
[x.w, v.v + sp.zoo]
[x.w, v.v + sp.Derivative(x.w, x.x)]
[x.w, True]
[x.w, v.v + x.x ** 1e300]
[x.w, v.v + 10**400]
{x.w: 1, x.x: 2}
(e for e in (x.w, x.x))
[x, x]
[x.w, v.v + p.k * sp.Abs(x.x)]
np.array([1, 2])
[x[5], x[0]]
[x.w, v.v + 1j]
[x.w, v.v + sp.Sum(x.x, (x.x, 1, 3))]
sp.Matrix([x.w, x.x])
[sp.Lambda(x.x, x.x), x.w]
[x.w, v.v + sp.Max(x.x, x.w)]
[x.w, x.x % 2]"""
WRONG = {
    **dict.fromkeys(("states", "inputs", "noises", "outputs"), QUANTITIES.splitlines()),
    "dynamics": EQUATIONS.splitlines(),
    "output": EQUATIONS.replace("[x.w, ", "[").replace("v.v + ", "").splitlines(),
    "parameters": PARAMETERS.splitlines(),
    "name": ['""', "None", "3", '"../../x"', '"a b"', r'"\x1b[2J"', '"é" * 300', "[]"],
    "sample_time": ["0", "-1", '"0.01"', "None", 'float("nan")', 'float("inf")', "1e-320", "True", "10**400"],
    "discretisation": ['""', '"rk5"', "None", "3", '"exact"', '"van_loan"', '"discrete"', '["euler"]'],
}
"""What is put in the place of a part, one a line."""


@st.composite
def model_files(draw):
    """The source of a model with one or two of its parts exchanged; now and then with a text change as well."""
    parts = dict(RIGHT)
    for name in draw(st.lists(st.sampled_from(list(RIGHT)), min_size=1, max_size=2, unique=True)):
        parts[name] = draw(st.sampled_from(WRONG[name]))
    source = SOURCE.format(**parts)
    if draw(st.integers(0, 9)) == 0:
        i = draw(st.integers(0, len(source)))
        source = source[:i] + draw(st.sampled_from(["(", "\t", "\0", "return", "\x0c", "'''", "é", "\\"])) + source[i:]
    return source


@settings(max_examples=COUNT)
@given(model_files())
def test_model_files_are_taken_or_refused(folder, tried, source):
    tried()
    (folder / "cart.py").write_text(source)
    document = experiment({"file": "cart.py", "class": "Cart"}, 2)
    document["simulate"]["trajectory"] = {"kind": "multisine", "amplitude": [1], "lowest": 1, "highest": 5, "lines": 3}
    outcome(folder, document)

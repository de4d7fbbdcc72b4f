"""Models by name and from files, and their description."""

import os
import re
import sys
from pathlib import Path

import pytest
import sympy as sp

from noiseid_cli.errors import ModelError
from noiseid_cli.models.describe import describe
from noiseid_cli.models.registry import load_model, load_model_file, model_names

PENDULUM = Path(__file__).parents[2] / "configs" / "double_pendulum.py"


def test_every_built_in_system_loads_under_its_name():
    for name in model_names():
        model = load_model(name)
        assert model.name == name
        assert model.citation
        assert all(p.source for p in model.parameters)


def test_unknown_model_names_the_nearest():
    with pytest.raises(ModelError, match="model flexible_robto is not known; did you mean flexible_robot"):
        load_model("flexible_robto")


def test_parameters_reach_the_model():
    assert load_model("flexible_robot", {"g": 1.6}).values["g"] == 1.6
    assert load_model_file(str(PENDULUM), "DoublePendulum", {"m1": 0.6}).values["m1"] == 0.6


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("import math\n\nx = math.nothing\n", r"robot\.py:3: AttributeError: module 'math' has no attribute"),
        ("a = 1\ndef f(:\n", r"robot\.py:2: SyntaxError"),
        ("raise SystemExit('enough')\n", r"robot\.py:1: SystemExit: enough"),
        ("import no_such_package\n", r"robot\.py:1: ModuleNotFoundError: No module named 'no_such_package'"),
        ("x = 1\n", r"no model class Robot; it defines none"),
        ("class Robot: pass\n", r"Robot is not a model; write class Robot\(Model\)"),
        (
            "from noiseid_cli.models import Model\nclass Arm(Model): pass\nclass Leg(Model): pass\n",
            r"no model class Robot; it defines Arm, Leg",
        ),
        ("from noiseid_cli.models import Model\nclass Robot(Model): pass\n", "Robot: give the model a name"),
    ],
)
def test_faulty_model_files(tmp_path, text, message):
    file = tmp_path / "robot.py"
    file.write_text(text)
    with pytest.raises(ModelError, match=message):
        load_model_file(file, "Robot")


def test_missing_or_misnamed_file(tmp_path):
    with pytest.raises(ModelError, match=r"nothing\.py: no such model file"):
        load_model_file(tmp_path / "nothing.py", "Robot")
    (tmp_path / "robot.txt").write_text("")
    with pytest.raises(ModelError, match=r"its name must end in \.py"):
        load_model_file(tmp_path / "robot.txt", "Robot")


def test_a_model_file_is_taken_as_it_is_now_and_leaves_nothing_beside_it(tmp_path, monkeypatch):
    """Byte code on the disk would be taken for the file's where both are of one second and one length."""
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    file, text = tmp_path / "pendulum.py", PENDULUM.read_text()
    for wanted in (0.1, 0.2):
        file.write_text(text + f"\n\nclass Other(DoublePendulum):\n    sample_time = {wanted}\n")
        os.utime(file, (1e9, 1e9))
        assert load_model_file(file, "Other").sample_time == wanted
    assert list(tmp_path.iterdir()) == [file]


@pytest.fixture(params=["flexible_robot", "double_pendulum"])
def model(request):
    if request.param == "double_pendulum":
        return load_model_file(PENDULUM, "DoublePendulum", {"m1": 0.6})
    return load_model("flexible_robot")


def test_described_equations_read_back_as_the_equations(model):
    """Each line of text, with its dots and superscripts undone, is the expression itself."""
    eq = model.equations()
    expressions = [*eq.terms.values(), *eq.dynamics, *eq.output, *eq.performance]
    described = describe(model).equations
    names = {str(s): s for s in [*eq.x, *eq.u, *eq.v, *eq.p, *eq.terms]}
    undo = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹", "0123456789")
    read = 0
    for line, expression in zip(described, expressions, strict=True):
        right = line.text.split(" = ", 1)[1]
        if "{" in right:
            assert expression.has(sp.Piecewise)
            continue
        plain = re.sub("[⁰¹²³⁴⁵⁶⁷⁸⁹]+", lambda m: "**" + m[0].translate(undo), right).replace("·", "*")
        assert sp.sympify(plain, locals=names) == expression, line.text
        assert line.latex.count("{") == line.latex.count("}")
        read += 1
    assert read >= len(expressions) - 2


def test_description_names_everything(model):
    description = describe(model)
    tables = {t.title: t for t in description.tables}
    assert [row[0] for row in tables["states"].rows] == [q.name for q in model.states]
    assert ("performances" in tables) == bool(model.performances)
    rows = {row[0]: row for row in tables["parameters"].rows}
    assert list(rows) == list(model.values)
    assert rows["g"][-1] == "chosen"
    if model.name == "double_pendulum":
        assert rows["m1"] == ("m1", "0.6", "kg", "mass of link 1", "given")
    assert description.summary.startswith(("Two-axis industrial robot", "Double pendulum with a motor"))
    assert "\n\n" in description.summary
    assert "  " not in description.summary


def test_latex_uses_the_models_own_names():
    lines = {e.name: e.latex for e in describe(load_model("flexible_robot")).equations if e.kind == "dynamics"}
    assert lines["qa1"] == r"\frac{d}{dt} q_{a1} = \dot q_{a1}"

"""The cache of compiled models, and code generation for each function that equations may use."""

import os
import subprocess
import sys
from pathlib import Path

import mpmath
import numpy as np
import pytest
import sympy as sp

from noiseid_cli.errors import ModelError
from noiseid_cli.models import Model, Parameter, Quantity, Terms, codegen
from noiseid_cli.models import compile as compile_module
from noiseid_cli.models.compile import cache_key, compile_model

SOURCE = """
import sympy as sp
from noiseid_cli.models import Model, Parameter, Quantity

class Decay(Model):
    name = "decay"
    states = (Quantity("level"),)
    noises = (Quantity("drip"),)
    outputs = (Quantity("height"),)
    parameters = (Parameter("rate", 0.5),)
    sample_time = 0.1
    discretisation = "euler"

    def dynamics(self, x, u, v, p):
        return [-p.rate * x.level + v.drip]

    def output(self, x, u, p):
        return [x.level ** 2]
"""


class Decay(Model):
    name = "decay"
    states = (Quantity("level", "m"),)
    noises = (Quantity("drip", "m/s"),)
    outputs = (Quantity("height", "m"),)
    parameters = (Parameter("rate", 0.5, "1/s"),)
    sample_time = 0.1
    discretisation = "euler"
    power = 2

    def dynamics(self, x, u, v, p):
        return [-p.rate * x.level**self.power + v.drip]

    def output(self, x, u, p):
        return [x.level]


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("NOISEID_CACHE_DIR", str(tmp_path / "cache"))
    for name in [n for n in sys.modules if n.startswith("noiseid_model_")]:
        monkeypatch.delitem(sys.modules, name)
    return tmp_path / "cache"


def test_second_compilation_generates_nothing(cache, monkeypatch):
    generated, messages = [], []
    original = codegen.module_source
    monkeypatch.setattr(codegen, "module_source", lambda eq: generated.append(1) or original(eq))
    first = compile_model(Decay(), messages.append)
    for name in [n for n in sys.modules if n.startswith("noiseid_model_")]:
        monkeypatch.delitem(sys.modules, name)
    second = compile_model(Decay(rate=0.7), messages.append)
    assert generated == [1]
    assert messages == ["Compiling the equations of decay (once on this machine)."]
    assert first.parameters.tolist() == [0.5]
    assert second.parameters.tolist() == [0.7]
    dx = np.empty(1)
    second.drift(np.array([2.0]), np.zeros(0), np.array([1.0]), second.parameters, dx)
    assert dx[0] == pytest.approx(-0.7 * 4 + 1)
    assert second.drift.stats.cache_hits  # numba took the machine code from its cache as well
    assert (second.states, second.inputs, second.noises, second.outputs) == (("level",), (), ("drip",), ("height",))
    assert (second.nx, second.nu, second.nv, second.ny, second.nz) == (1, 0, 1, 1, 0)
    assert second.units == {"level": "m", "drip": "m/s", "height": "m"}
    assert len(list((cache / "models").iterdir())) == 1


def test_key_follows_the_equations_and_versions_only(monkeypatch):
    key = cache_key(Decay().equations())
    assert key == cache_key(Decay(rate=3).equations())
    cubic = type("Decay", (Decay,), {"power": 3})  # same source text, other equations
    renamed = type("Decay", (Decay,), {"parameters": (Parameter("speed", 0.5), Parameter("rate", 1))})
    keys = {key, cache_key(cubic().equations()), cache_key(renamed().equations())}
    monkeypatch.setattr(codegen, "GENERATOR_VERSION", -1)
    assert len(keys | {cache_key(Decay().equations())}) == 4


def test_two_processes_may_compile_at_once(tmp_path):
    (tmp_path / "decay.py").write_text(SOURCE)
    code = (
        "import numpy as np\n"
        "from noiseid_cli.models.registry import load_model_file\n"
        "from noiseid_cli.models.compile import compile_model\n"
        f"c = compile_model(load_model_file({str(tmp_path / 'decay.py')!r}, 'Decay'))\n"
        "y = np.empty(1)\n"
        "c.output(np.array([3.0]), np.zeros(0), c.parameters, y)\n"
        "print(y[0])\n"
    )
    env = {**os.environ, "NOISEID_CACHE_DIR": str(tmp_path / "cache")}
    root = Path(__file__).parents[2]
    both = [
        subprocess.Popen([sys.executable, "-c", code], env=env, cwd=root, stdout=-1, stderr=-1, text=True)
        for _ in range(2)
    ]
    for process in both:
        out, err = process.communicate(timeout=60)
        assert (out, err, process.returncode) == ("9.0\n", "", 0)
    folder = next((tmp_path / "cache" / "models").iterdir())
    assert not list(folder.glob("*.part"))


def test_cache_folder_that_cannot_be_written(cache):
    cache.write_text("a file where the folder should be")
    with pytest.raises(ModelError, match=r"cannot be kept in .*Set NOISEID_CACHE_DIR to a folder"):
        compile_model(Decay())


def test_damaged_cache_is_named(cache):
    folder = cache / "models" / cache_key(Decay().equations())
    folder.mkdir(parents=True)
    (folder / "equations.py").write_text("import math\nmath.nothing\n")
    with pytest.raises(ModelError, match=r"are damaged \(AttributeError.*Delete that folder"):
        compile_model(Decay())


def test_default_cache_folder_is_the_users(monkeypatch):
    import platformdirs

    monkeypatch.delenv("NOISEID_CACHE_DIR", raising=False)
    assert compile_module.cache_folder() == Path(platformdirs.user_cache_dir("noiseid")) / "models"


FORMULAS = {
    **{name: getattr(sp, name) for name in codegen.FUNCTIONS if name not in ("atan2", "sign", "floor", "ceiling")},
    "acosh": lambda z: sp.acosh(z + 2),
    "Abs": sp.Abs,
    "atan2": lambda z: sp.atan2(z, z + 1),
    "sqrt": lambda z: sp.sqrt(z) + 1 / sp.sqrt(z + 1),
    "powers": lambda z: z**-3 + (z + 1) ** sp.Rational(5, 3) + (z + 2) ** z + 2**z + z ** sp.Rational(-1, 3),
    "max": lambda z: sp.Max(z, sp.Rational(1, 4), z**2),
    "min": lambda z: sp.Min(z, 2 - z),
    "numbers": lambda z: sp.pi * z + sp.E + sp.Rational(1, 3) + sp.Float("0.1") + 10**20 * z,
    "piecewise": lambda z: sp.Piecewise((z**2, (z > 0) & (z < sp.Rational(1, 2))), (z, sp.Ne(z, 3)), (0, True)),
}
del FORMULAS["Heaviside"]  # its slope is refused; it appears in derivatives of Max


def test_every_function_is_compiled_with_its_slope(cache):
    """One model with one output for each function; values and slopes against 30-digit arithmetic."""

    class Zoo(Model):
        name = "zoo"
        states = (Quantity("z"),)
        noises = (Quantity("n"),)
        outputs = tuple(Quantity(f"y{i}") for i in range(len(FORMULAS)))
        sample_time = 1.0
        discretisation = "discrete"

        def terms(self, x, u, p):
            t = Terms()
            t.half = x.z / 2
            t.unused = x.z**7
            return t

        def dynamics(self, x, u, v, p):
            return [2 * self.terms(x, u, p).half + v.n]

        def output(self, x, u, p):
            return [f(x.z) for f in FORMULAS.values()]

    compiled = compile_model(Zoo())
    z = sp.Symbol("z", real=True)
    value, H = np.full(len(FORMULAS), np.nan), np.full((len(FORMULAS), 1), np.nan)
    for point in (0.3, 0.7):
        compiled.output_jacobian(np.array([point]), np.zeros(0), compiled.parameters, value, H)
        for i, (name, formula) in enumerate(FORMULAS.items()):
            with mpmath.workdps(30):
                exact = sp.lambdify(z, formula(z), "mpmath")
                assert value[i] == pytest.approx(float(exact(mpmath.mpf(point))), rel=1e-14), name
                assert H[i, 0] == pytest.approx(float(mpmath.diff(exact, mpmath.mpf(point))), rel=1e-13), name


def test_sign_and_rounding_functions_where_no_slope_is_asked_for():
    """They are compiled in derivatives, such as that of Abs, and refused where their own slope is needed."""
    eq = Decay().equations()
    text = codegen.module_source(type(eq)(**{**vars(eq), "output": (sp.Abs(eq.x[0]),)}))
    assert "math.copysign(1.0, x_level) if x_level != 0.0 else 0.0" in text

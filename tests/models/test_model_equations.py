"""A model class checks itself: each fault of a user's file gives its own sentence."""

import math
import sys

import pytest
import sympy as sp

from noiseid_cli.errors import ModelError
from noiseid_cli.models import Model, Parameter, Quantity, Terms
from noiseid_cli.models.compile import compile_model


class Cart(Model):
    """A cart on a spring."""

    name = "cart"
    states = (Quantity("s", "m"), Quantity("w", "m/s"))
    inputs = (Quantity("force", "N"),)
    noises = (Quantity("push", "N"),)
    outputs = (Quantity("s", "m"),)
    parameters = (Parameter("mass", 2.0, "kg", "mass", source="chosen"), Parameter("stiffness", 8.0, "N/m"))
    sample_time = 0.01
    discretisation = "rk4"

    def dynamics(self, x, u, v, p):
        return [x.w, (u.force + v.push - p.stiffness * x.s) / p.mass]

    def output(self, x, u, p):
        return [x.s]


def changed(**members):
    return type("Cart", (Cart,), members)


def test_parameters_by_mapping_and_keyword():
    model = Cart({"mass": 3, "stiffness": 5}, mass=4)
    assert model.values == {"mass": 4.0, "stiffness": 5.0}
    assert model.vector.tolist() == [4.0, 5.0]
    assert Cart(stiffness=1).parameters_in_force == (
        Cart.parameters[0],
        Parameter("stiffness", 1.0, "N/m", source="given"),
    )
    assert Cart().vector.tolist() == [2.0, 8.0]


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"mas": 1}, "parameter mas is not known; did you mean mass"),
        ({"zzz": 1}, "parameter zzz is not known; known: mass, stiffness"),
        ({"mass": math.nan}, "parameter mass is nan; it must be a finite number"),
        ({"mass": True}, "parameter mass is True"),
        ({"mass": "2"}, "parameter mass is '2'"),
    ],
)
def test_wrong_parameters(given, text):
    with pytest.raises(ModelError, match=text):
        Cart(given)


@pytest.mark.parametrize(
    ("members", "text"),
    [
        ({"name": ""}, "give the model a name"),
        ({"states": ()}, "states is empty"),
        ({"noises": ()}, "noises is empty"),
        ({"outputs": ()}, "outputs is empty"),
        ({"states": Quantity("s")}, "with a comma for a single one"),
        ({"states": ("s", "w")}, "states holds 's'; it must hold Quantity"),
        ({"parameters": (Quantity("mass"),)}, "must hold Parameter"),
        ({"inputs": (Quantity("2force"),)}, "'2force' cannot be a name"),
        ({"inputs": (Quantity("lambda"),)}, "'lambda' cannot be a name"),
        ({"inputs": (Quantity("_u"),)}, "'_u' cannot be a name"),
        ({"inputs": (Quantity("mass"),)}, "declared twice: mass"),
        ({"outputs": (Quantity("y"), Quantity("y"))}, "declared twice: y"),
        ({"outputs": (Quantity("s", "mm"),)}, "s has the unit 'm' in one place and 'mm' in another"),
        ({"parameters": (Parameter("mass", math.inf),)}, "default of parameter mass is inf"),
        ({"sample_time": 0}, "sample_time is 0 s; it must be above zero"),
        ({"sample_time": None}, "sample_time is None"),
        ({"discretisation": "heun"}, "'heun'; it must be one of discrete, euler, rk4"),
    ],
)
def test_wrong_declarations(members, text):
    with pytest.raises(ModelError, match=text):
        changed(**members)()


def dynamics(function):
    return {"dynamics": lambda self, x, u, v, p: function(x, u, v, p)}


def output(function):
    return {"output": lambda self, x, u, p: function(x, u, p)}


def terms(**definitions):
    def method(self, x, u, p):
        t = Terms()
        for name, make in definitions.items():
            setattr(t, name, make(x, u, p, t))
        return t

    return {"terms": method}


@pytest.mark.parametrize(
    ("members", "text"),
    [
        (dynamics(lambda x, u, v, p: [x.w]), "returns 1 expressions for 2 names: s, w"),
        (dynamics(lambda x, u, v, p: None), "must return a list of formulas, not None"),
        (dynamics(lambda x, u, v, p: [x.w, x.speed]), "x.speed is not known; known: s, w"),
        (dynamics(lambda x, u, v, p: [x.w, u.forc]), "u.forc is not known; did you mean force"),
        (dynamics(lambda x, u, v, p: [x.w, math.sin(x.s)]), "use sympy's functions"),
        (dynamics(lambda x, u, v, p: [x.w, "x.s"]), "expression of w is 'x.s', which is not a sympy expression"),
        (dynamics(lambda x, u, v, p: [x.w, x.s > 1]), "not a single number or formula"),
        (dynamics(lambda x, u, v, p: [x.w, x.s / sp.Integer(0)]), "is there a division by 0"),
        (dynamics(lambda x, u, v, p: [x.w, sp.Symbol("k") + v.push]), "not declared or not allowed there: k"),
        (dynamics(lambda x, u, v, p: [x.w, v.push**2]), "noise push enters the equation of w nonlinearly"),
        (dynamics(lambda x, u, v, p: [x.w, sp.sin(v.push)]), "noise push enters the equation of w nonlinearly"),
        (dynamics(lambda x, u, v, p: [x.w, x.s]), "the noise push drives no state"),
        (dynamics(lambda x, u, v, p: [x.w, sp.sign(x.w) + v.push]), "have no slope at their jump"),
        (dynamics(lambda x, u, v, p: [x.w, sp.besselj(0, x.w) + v.push]), "holds besselj, which cannot be compiled"),
        (
            dynamics(lambda x, u, v, p: [x.w, sp.Integral(x.s, x.w) + v.push]),
            "holds Integral, which cannot be compiled",
        ),
        (
            dynamics(lambda x, u, v, p: [x.w, 10**5000 + v.push]),
            r"holds a number above 1\.8e\+308, the largest there is",
        ),
        (
            dynamics(lambda x, u, v, p: [x.w, x.s * sp.Rational(1, 10**5000) + v.push]),
            "largest there is, or one over it",
        ),
        (
            dynamics(lambda x, u, v, p: sp.Matrix([x.w, x.s])),
            r"must return a list of formulas, not Matrix\(\[ \[w\], \[s\]\]\)",
        ),
        (dynamics(lambda x, u, v, p: sys.exit(3)), "SystemExit: 3"),
        (output(lambda x, u, p: [sp.Matrix([[1]])]), "holds ImmutableDenseMatrix, which cannot be compiled"),
        ({"parameters": (Parameter("d", 10**5000),)}, "parameter d is a whole number of too many digits"),
        (output(lambda x, u, p: [x.s, x.w]), "output returns 2 expressions for 1 names: s"),
        (output(lambda x, u, p: [sp.Symbol("push", real=True)]), "not allowed there: push"),
        ({"performances": (Quantity("z"),)}, "performance returns 0 expressions for 1 names: z"),
        ({"terms": lambda self, x, u, p: {}}, "terms must return a Terms object"),
        (terms(mass=lambda x, u, p, t: x.s), "terms: mass is declared as a quantity too"),
        (terms(a=lambda x, u, p, t: t.b), "term b is not known; known: none"),
        (terms(a=lambda x, u, p, t: sp.Symbol("a", real=True)), "expression of a uses symbols"),
    ],
)
def test_wrong_equations(members, text):
    with pytest.raises(ModelError, match=text):
        compile_model(changed(**members)())


def test_missing_methods_are_named():
    class Bare(Cart):
        dynamics = Model.dynamics

    with pytest.raises(ModelError, match=r"Bare: write the method dynamics\(self, x, u, v, p\)"):
        Bare().equations()


def test_line_of_the_fault_is_given():
    with pytest.raises(ModelError, match=r"Faulty.dynamics, line \d+: ZeroDivisionError"):
        Faulty().equations()


class Faulty(Cart):
    def dynamics(self, x, u, v, p):
        return [x.w, 1 / 0]


def test_noise_that_is_linear_only_after_simplification_is_accepted():
    gain = changed(**dynamics(lambda x, u, v, p: [x.w, (v.push + x.s) ** 2 - v.push**2 - x.s**2]))
    assert len(gain().equations().dynamics) == 2


def test_a_term_cannot_be_defined_twice():
    t = Terms()
    t.a = sp.Integer(1)
    with pytest.raises(ModelError, match="term a is defined twice"):
        t.a = sp.Integer(2)


def test_vectors_are_read_by_name_and_number():
    seen = {}

    def look(x, u, v, p):
        seen.update(same=x.s == x["s"] == x[0], count=len(x), all=list(x) == [x.s, x.w])
        return [x.w, v.push]

    changed(**dynamics(look))().equations()
    assert seen == {"same": True, "count": 2, "all": True}

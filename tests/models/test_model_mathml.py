"""Equations as MathML: the names of the configs, fractions and cases as on paper, elements that browsers draw."""

from xml.etree import ElementTree

import pytest
import sympy as sp

from noiseid_cli.models.describe import describe
from noiseid_cli.models.mathml import mathml
from noiseid_cli.models.registry import find_model
from noiseid_cli.report.render_math import html_math

q, tau = sp.symbols("qm1 tau_f")


def words(text):
    return "".join(ElementTree.fromstring(text).itertext()).replace("\u00a0", " ")


def test_names_are_those_of_the_configs_and_rates_are_fractions():
    text = mathml("d qm1/dt", q**2 * tau / 2)
    assert "<mfrac><mi>d qm1</mi><mi>dt</mi></mfrac><mo>=</mo>" in text
    assert "<msup><mi>qm1</mi><mn>2</mn></msup>" in text
    assert words(text) == "d qm1dt=qm12·tau_f2"


def test_cases_and_small_numbers():
    text = mathml("a", sp.Piecewise((q, tau > 0), (2.5e-5 * q, True)))
    assert words(text) == "a={qm1if tau_f>02.5·10−5·qm1otherwise"
    assert text.count("<mtr>") == 2


@pytest.mark.parametrize("name", ["flexible_robot", "one_link", "markov_manipulator"])
def test_every_equation_of_a_model_passes_into_the_page(name):
    for equation in describe(find_model(name)).equations:
        assert html_math(equation.mathml, equation.text).startswith("<math ")

"""A model as text: its equations in one-line unicode and in LaTeX, and tables of its names."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sympy import true
from sympy.printing.latex import LatexPrinter
from sympy.printing.str import StrPrinter

from noiseid_cli.models.declarations import Quantity
from noiseid_cli.models.equations import Model
from noiseid_cli.models.mathml import mathml

_SUPERSCRIPTS = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
_HEADINGS = ("name", "unit", "description")


@dataclass(frozen=True)
class Equation:
    """One line of a model.

    Attributes:
        kind: ``definition``, ``dynamics``, ``output`` or ``performance``.
        name: the term, state or output that it is about.
        text: the equation on one line, with the names as they are written in configs.
        latex: the same in LaTeX, without dollar signs.
        mathml: the same as MathML, without the ``math`` element.
    """

    kind: str
    name: str
    text: str
    latex: str
    mathml: str


@dataclass(frozen=True)
class Table:
    """Rows of text under headings."""

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Description:
    """All that there is to read about a model.

    Attributes:
        name: name of the model.
        summary: the class's docstring, its paragraphs unwrapped.
        citation: the work it is from.
        sample_time: s.
        discretisation: ``euler``, ``rk4``, ``exact`` or ``discrete``.
        equations: definitions first, in the order in which they build on each other.
        tables: states, inputs, noises, outputs, performances and parameters; empty ones left out.
    """

    name: str
    summary: str
    citation: str
    sample_time: float
    discretisation: str
    equations: tuple[Equation, ...]
    tables: tuple[Table, ...]


def describe(model: Model) -> Description:
    """Description of a model at its parameter values.

    Raises:
        ModelError: the equations are faulty.
    """
    doc = type(model).__doc__ or ""
    paragraphs = [" ".join(part.split()) for part in doc.strip().split("\n\n")]
    return Description(
        name=model.name,
        summary="\n\n".join(paragraphs),
        citation=model.citation,
        sample_time=model.sample_time,
        discretisation=model.discretisation,
        equations=_equations(model),
        tables=tuple(t for t in _tables(model) if t.rows),
    )


def _equations(model: Model) -> tuple[Equation, ...]:
    eq = model.equations()
    text, latex = _Text(), _Latex(model)
    discrete = model.discretisation == "discrete"
    lines = []

    def add(kind: str, name: str, left: str, left_latex: str, expression: Any) -> None:
        right, right_latex = text.doprint(expression), latex.doprint(expression)
        latex_line = f"{left_latex} = {right_latex}"
        lines.append(Equation(kind, name, f"{left} = {right}", latex_line, mathml(left, expression)))

    for term, definition in eq.terms.items():
        add("definition", str(term), str(term), latex.doprint(term), definition)
    for s, f in zip(eq.x, eq.dynamics, strict=True):
        rate = rf"{latex.doprint(s)}[k+1]" if discrete else rf"\frac{{d}}{{dt}} {latex.doprint(s)}"
        add("dynamics", str(s), f"{s}[k+1]" if discrete else f"d {s}/dt", rate, f)
    for kind, letter, names, expressions in (
        ("output", "y", model.outputs, eq.output),
        ("performance", "z", model.performances, eq.performance),
    ):
        for q, expression in zip(names, expressions, strict=True):
            add(kind, q.name, f"{letter}[{q.name}]", rf"{letter}_{{{latex.name(q.name)}}}", expression)
    return tuple(lines)


def _tables(model: Model) -> list[Table]:
    def quantities(title: str, group: tuple[Quantity, ...]) -> Table:
        return Table(title, _HEADINGS, tuple((q.name, q.unit, q.description) for q in group))

    rows = tuple((p.name, f"{p.value:.6g}", p.unit, p.description, p.source) for p in model.parameters_in_force)
    return [
        quantities("states", model.states),
        quantities("inputs", model.inputs),
        quantities("noises", model.noises),
        quantities("outputs", model.outputs),
        quantities("performances", model.performances),
        Table("parameters", ("name", "value", "unit", "description", "source"), rows),
    ]


class _Text(StrPrinter):  # type: ignore[misc]
    """One-line unicode: a dot for products, superscripts for whole powers, braces for branches."""

    def _print_Float(self, e: Any) -> str:
        return repr(float(e))

    def _print_Mul(self, e: Any) -> str:
        return str(super()._print_Mul(e)).replace("*", "·")

    def _print_Pow(self, e: Any, rational: bool = False) -> str:
        if e.exp.is_Integer and int(e.exp) > 1:
            base = self._print(e.base)
            base = base if e.base.is_Atom or e.base.is_Function else f"({base})"
            return base + str(int(e.exp)).translate(_SUPERSCRIPTS)
        return str(super()._print_Pow(e, rational=rational))

    def _print_Piecewise(self, e: Any) -> str:
        branches = [
            self._print(value) + (" otherwise" if condition is true else f" if {self._print(condition)}")
            for value, condition in e.args
        ]
        return "{ " + "; ".join(branches) + " }"


class _Latex(LatexPrinter):  # type: ignore[misc]
    """LaTeX with the model's own renderings of names."""

    def __init__(self, model: Model) -> None:
        super().__init__()
        self._names = dict(model.latex_names)

    def name(self, name: str) -> str:
        """LaTeX of one name."""
        return self._names.get(name) or str(self._deal_with_super_sub(name))

    def _print_Float(self, e: Any) -> str:
        mantissa, _, exponent = repr(float(e)).partition("e")
        return rf"{mantissa} \cdot 10^{{{int(exponent)}}}" if exponent else mantissa

    def _print_Symbol(self, e: Any, style: str = "plain") -> str:
        return self.name(e.name)

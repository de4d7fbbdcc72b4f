"""Equations as MathML: fractions, powers and cases as on paper, names as they are written in configs."""

from __future__ import annotations

from typing import Any

from sympy import true
from sympy.printing.mathml import MathMLPresentationPrinter


def mathml(left: str, expression: Any) -> str:
    """The equation ``left = expression`` in presentation MathML, without the ``math`` element around it.

    Args:
        left: what stands before the equals sign, as text; a slash makes a fraction.
        expression: a sympy expression.
    """
    printer = _MathML()
    row = printer.dom.createElement("mrow")
    for node in (printer.side(left), printer.sign("="), printer._print(expression)):
        row.appendChild(node)
    return str(row.toxml())


class _MathML(MathMLPresentationPrinter):  # type: ignore[misc]
    """Sympy's printer with our names, numbers and branches, in elements that browsers draw (MathML Core)."""

    def __init__(self) -> None:
        super().__init__({"mul_symbol": "dot"})

    def word(self, text: str, kind: str = "mi") -> Any:
        """An element with text in it."""
        node = self.dom.createElement(kind)
        node.appendChild(self.dom.createTextNode(text))
        return node

    def side(self, text: str) -> Any:
        """A name, or a rate of change as a fraction."""
        above, slash, below = text.partition("/")
        if not slash:
            return self.word(text)
        fraction = self.dom.createElement("mfrac")
        fraction.appendChild(self.word(above))
        fraction.appendChild(self.word(below))
        return fraction

    def sign(self, text: str) -> Any:
        """An operator."""
        return self.word(text, "mo")

    def _print_Symbol(self, sym: Any, style: str = "plain") -> Any:
        # Greek letters and subscripts would part the equations from the names in tables, figures and configs.
        return self.word(sym.name)

    def _print_Exp1(self, e: Any) -> Any:
        return self.word("e")  # the letter of its own that sympy takes is missing in many fonts

    def _print_Float(self, e: Any) -> Any:
        mantissa, _, exponent = repr(float(e)).partition("e")
        if not exponent:
            return self.word(mantissa, "mn")
        row, power = self.dom.createElement("mrow"), self.dom.createElement("msup")
        power.appendChild(self.word("10", "mn"))
        power.appendChild(self.word(str(int(exponent)).replace("-", "−"), "mn"))
        for node in (self.word(mantissa, "mn"), self.sign("·"), power):
            row.appendChild(node)
        return row

    def _print_Piecewise(self, expr: Any) -> Any:
        row, table = self.dom.createElement("mrow"), self.dom.createElement("mtable")
        for value, condition in expr.args:
            line = self.dom.createElement("mtr")
            when = self.dom.createElement("mrow")
            when.appendChild(self.word("otherwise" if condition is true else "if\u00a0", "mtext"))
            if condition is not true:
                when.appendChild(self._print(condition))
            cells = [self._print(value), when]
            for cell in cells:
                box = self.dom.createElement("mtd")
                box.appendChild(cell)
                line.appendChild(box)
            table.appendChild(line)
        row.appendChild(self.sign("{"))
        row.appendChild(table)
        return row

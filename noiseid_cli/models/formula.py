"""What may stand in an equation: what can be compiled. Told when a model is checked, long before it is compiled."""

from __future__ import annotations

import sys
from typing import Any


def obstacle(expression: Any) -> str:
    """What keeps an expression from being compiled, in words; empty if nothing does.

    Args:
        expression: a sympy expression.
    """
    import sympy as sp
    from sympy.core.relational import Relational
    from sympy.functions.elementary.piecewise import ExprCondPair
    from sympy.logic.boolalg import BooleanAtom

    from noiseid_cli.models.codegen import FUNCTIONS

    plain = (sp.Symbol, sp.NumberSymbol, sp.Add, sp.Mul, sp.Pow, sp.Max, sp.Min, sp.Piecewise, ExprCondPair)
    logic = (Relational, BooleanAtom, sp.And, sp.Or, sp.Not)
    for part in sp.preorder_traversal(expression):
        if isinstance(part, sp.Number):
            if not _fits(part):
                return f"a number above {sys.float_info.max:.2g}, the largest there is, or one over it"
        elif not isinstance(part, plain + logic) and type(part).__name__ not in FUNCTIONS:
            known = ", ".join(sorted(FUNCTIONS))
            return f"{type(part).__name__}, which cannot be compiled; known: {known}, sqrt, Max, Min, Piecewise"
    return ""


def _fits(number: Any) -> bool:
    """It can be written as a float; a fraction as two."""
    largest = sys.float_info.max
    if number.is_Rational:
        return bool(abs(number.p) <= largest and number.q <= largest)
    return bool(abs(number) <= largest)

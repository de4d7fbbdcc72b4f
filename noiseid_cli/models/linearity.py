"""What a model's equations depend on: are they linear in states and noises, do outputs see inputs directly?"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from noiseid_cli.models.equations import Equations


def nonlinearity(equations: Equations) -> str:
    """What keeps the dynamics from being linear in x and v, in words; empty if they are linear.

    Coefficients may depend on parameters and on inputs, which are held over an interval.

    Args:
        equations: checked equations of a model.
    """
    import sympy as sp

    moving = {*equations.x, *equations.v}
    terms: dict[Any, Any] = {}
    for term, definition in equations.terms.items():
        terms[term] = definition.xreplace(terms)
    for state, f in zip(equations.x, equations.dynamics, strict=True):
        whole = f.xreplace(terms)
        for symbol in sorted(whole.free_symbols & moving, key=str):
            slope = sp.diff(whole, symbol)
            if slope.free_symbols & moving:
                slope = sp.simplify(slope)
            if left := slope.free_symbols & moving:
                by = ", ".join(sorted(map(str, left)))
                return f"the rate of {state} is not linear: its slope in {symbol} depends on {by}"
    return ""


def direct_inputs(equations: Equations) -> list[set[str]]:
    """The inputs on which each output depends directly, without a state between them.

    Args:
        equations: checked equations of a model.
    """
    inputs = set(equations.u)
    terms: dict[Any, Any] = {}
    for term, definition in equations.terms.items():
        terms[term] = definition.xreplace(terms)
    return [{str(s) for s in h.xreplace(terms).free_symbols & inputs} for h in equations.output]

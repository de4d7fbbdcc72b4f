"""A model with some of its parameters moved into the state, where they stay constant.

The Jacobians of the stacked model hold those of the model: with z = (x, theta), dz_next/dz = [F, dF1/dtheta; 0, I]
and dh/dz = [H, dh/dtheta], for every discretisation.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from noiseid_cli.errors import ModelError
from noiseid_cli.models.declarations import Parameter, Quantity, Terms, symbol, unknown_name
from noiseid_cli.models.equations import Equations, Model


def stack_parameters(model: Model, names: Sequence[str]) -> Model:
    """The model whose state is (x, theta), theta the named parameters.

    Args:
        model: the model; its other parameters keep their values.
        names: of the parameters that become states, in this order.

    Raises:
        ModelError: a name is not a parameter of the model, or is given twice, or the discretisation is exact: the
            stacked equations are not linear in the state any more.
    """
    eq = model.equations()
    return _derived(model, eq, _moved(model, names), [])


def stack_gains(model: Model, names: Sequence[str]) -> Model | None:
    """The stacked model with the noise gain as further states g[i, a] = dx_i/dv_a; None if the gain is constant.

    A step from g = 0 ends at g = F2(x, u), for the discretisation of the differentiated equations g' = (df/dx) g +
    df/dv is the derivative of the discretisation. Its Jacobian therefore is the gain's derivative in x and theta.

    Args:
        model: the model.
        names: as in ``stack_parameters``; the order of the states is (x, theta, g by rows).
    """
    import sympy as sp

    eq = model.equations()
    moved = _moved(model, names)
    dynamics = _without_terms(eq)
    B = sp.Matrix(dynamics).jacobian(list(eq.v)) if eq.v else sp.zeros(len(eq.x), 0)
    varying = {*eq.x, *(symbol(name) for name in names)}
    if model.discretisation != "rk4" and not B.free_symbols & varying:
        return None
    g = [[symbol(f"gain_{state}_{noise}") for noise in eq.v] for state in eq.x]
    rates = B
    if model.discretisation != "discrete":
        rates += sp.Matrix(dynamics).subs(dict.fromkeys(eq.v, 0)).jacobian(list(eq.x)) * sp.Matrix(g)
    pairs = [(g[i][a], rates[i, a]) for i in range(len(eq.x)) for a in range(len(eq.v))]
    return _derived(model, eq, moved, pairs)


def _moved(model: Model, names: Sequence[str]) -> list[Parameter]:
    """The parameters that become states."""
    known = {p.name: p for p in model.parameters}
    for name in names:
        if name not in known:
            raise ModelError(unknown_name(f"{model.name}: parameter {name}", name, known))
    if names and model.discretisation == "exact":
        raise ModelError(f"{model.name}: parameters cannot join the state under exact discretisation; use rk4.")
    if len(set(names)) < len(names):
        raise ModelError(f"{model.name}: a parameter is named twice among {', '.join(names)}.")
    return [known[name] for name in names]


def _without_terms(eq: Equations) -> list[Any]:
    """The dynamics with every named term written out."""
    full: dict[Any, Any] = {}
    for term, definition in eq.terms.items():
        full[term] = definition.subs(full)
    return [f.subs(full) for f in eq.dynamics]


def _derived(model: Model, eq: Equations, moved: list[Parameter], gains: list[tuple[Any, Any]]) -> Model:
    """An instance of a model class made of equations that are there already."""
    import sympy as sp

    still = model.discretisation != "discrete"
    extra = [sp.Integer(0) if still else symbol(p.name) for p in moved]
    gone = {p.name for p in moved}

    def terms(self: Model, x: Any, u: Any, p: Any) -> Terms:
        out = Terms()
        for name, definition in eq.terms.items():
            out[str(name)] = definition
        return out

    members = {
        "name": f"{model.name}_stacked",
        "states": (
            *model.states,
            *(Quantity(p.name, p.unit, p.description) for p in moved),
            *(Quantity(str(g), "", "gain of a noise") for g, _ in gains),
        ),
        "inputs": model.inputs,
        "noises": model.noises,
        "outputs": model.outputs,
        "parameters": tuple(
            Parameter(p.name, model.values[p.name], p.unit, p.description)
            for p in model.parameters
            if p.name not in gone
        ),
        "sample_time": model.sample_time,
        "discretisation": model.discretisation,
        "terms": terms,
        "dynamics": lambda self, x, u, v, p: [*eq.dynamics, *extra, *(rate for _, rate in gains)],
        "output": lambda self, x, u, p: list(eq.output),
    }
    stacked: Model = type("Stacked", (Model,), members)()
    return stacked

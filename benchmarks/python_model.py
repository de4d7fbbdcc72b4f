"""The equations of an Euler model as Python functions, made by sympy: what an engineer has who uses no noiseid.

``math`` and not ``numpy`` computes them: of single numbers it is the faster one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from textbook import Array, Measure, Step

from noiseid_cli.models.equations import Model


def plain(model: Model) -> tuple[Callable[[Array, Array], Array], Callable[[Array, Array], Array]]:
    """The next state without noise (n,), and the output (ny,), of state and input."""
    dt, (dynamics, outputs) = model.sample_time, _written_out(model)
    drift = _function(model, dynamics.subs(dict.fromkeys(model.equations().v, 0)).T)
    output = _function(model, outputs.T)
    return (
        lambda x, u: x + dt * np.array(drift(x.tolist(), u.tolist())[0][0]),
        lambda x, u: np.array(output(x.tolist(), u.tolist())[0][0]),
    )


def with_jacobians(model: Model) -> tuple[Step, Measure]:
    """Step and output with their Jacobians, see ``textbook.em_pass``."""
    eq, dt = model.equations(), model.sample_time
    x, v, (driven, output) = list(eq.x), list(eq.v), _written_out(model)
    drift = driven.subs(dict.fromkeys(v, 0))
    dynamics = _function(model, drift.T, drift.jacobian(x), driven.jacobian(v))
    outputs = _function(model, output.T, output.jacobian(x))

    def step(x: Array, u: Array) -> tuple[Array, Array, Array]:
        f, A, B = dynamics(x.tolist(), u.tolist())
        return x + dt * np.array(f[0]), np.eye(len(x)) + dt * np.array(A), dt * np.array(B)

    def measure(x: Array, u: Array) -> tuple[Array, Array]:
        y, H = outputs(x.tolist(), u.tolist())
        return np.array(y[0]), np.array(H)

    return step, measure


def _written_out(model: Model) -> tuple[Any, Any]:
    """Dynamics and output as columns of states, inputs and noises alone."""
    import sympy as sp

    eq = model.equations()

    def flat(expressions: Any) -> Any:
        column = sp.Matrix(list(expressions))
        for term, definition in reversed(eq.terms.items()):
            column = column.subs(term, definition)
        return column.subs(dict(zip(eq.p, model.vector.tolist(), strict=True)))

    return flat(eq.dynamics), flat(eq.output)


def _function(model: Model, *parts: Any) -> Any:
    """Matrices as nested lists, of lists of states and inputs."""
    import sympy as sp

    eq = model.equations()
    math = [{"sech": lambda z: 1.0 / np.cosh(z)}, "math"]
    return sp.lambdify([list(eq.x), list(eq.u)], [part.tolist() for part in parts], modules=math, cse=True)

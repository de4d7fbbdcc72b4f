"""A model whose noise is coloured: a force with a memory, as model error has, in the place of a white one.

For each named noise v of x' = f(x, u, v) the model gains a state xi, a first-order Markov (Ornstein-Uhlenbeck) process
with the time constant tau, and a white noise w that drives it:

    x' = f(x, u, v = xi),  xi' = -xi / tau + w.

The augmented equations are equations like any other: their Jacobians are exact, tau is a parameter, and the intensity
of w is the process noise that is estimated. Over an interval dt, xi decays by exp(-dt / tau) under ``exact`` and
``discrete``; ``rk4`` gives that to (dt / tau)^5 / 120 and ``euler`` to (dt / tau)^2 / 2.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from noiseid_cli.errors import ModelError
from noiseid_cli.models.declarations import Parameter, Quantity, Symbols, Terms, symbol, unknown_name
from noiseid_cli.models.equations import Equations, Model


def with_markov_noise(model: Model, time_constants: Mapping[str, float], keep_white: bool = False) -> Model:
    """The model with first-order Markov processes in the place of some of its noises.

    For a noise ``v`` the new names are: state ``xi_v`` (in the unit of v), noise ``w_v`` (in that unit per second) and
    parameter ``tau_v`` (s). States and noises that were there come first. With w held over dt and per sample, the
    stationary variance of xi is Q_w tau dt / 2 for dt well below tau.

    Args:
        model: the model, at its parameter values; not changed.
        time_constants: tau, s, by the name of the noise.
        keep_white: the white noise stays beside the process: f gets xi + v.

    Returns:
        An instance of a new model class, with the same discretisation and sample time.

    Raises:
        ModelError: a name is not one of the model's noises, no noise is named, or a time constant is not above 0.
    """
    noises = {q.name: q for q in model.noises}
    for name, tau in time_constants.items():
        if name not in noises:
            raise ModelError(unknown_name(f"{model.name}: noise {name}", name, noises))
        if not 0.0 < tau < float("inf"):
            raise ModelError(f"{model.name}: the time constant of {name} is {tau} s; it must be above 0.")
    if not time_constants:
        raise ModelError(f"{model.name}: name at least one noise that is to be a Markov process.")
    on = [noises[name] for name in time_constants]
    words = _declarations(model, on, time_constants, keep_white)
    members = words | _equations(model, tuple(time_constants), keep_white)
    derived: Model = type(type(model).__name__, (Model,), members)()
    derived.discretisation = model.discretisation  # type: ignore[misc]  # an instance may differ from its class
    derived.overridden = model.overridden | {f"tau_{name}" for name in time_constants}
    return derived


def _declarations(
    model: Model, on: list[Quantity], time_constants: Mapping[str, float], keep_white: bool
) -> dict[str, Any]:
    """Names, units and words of the augmented model."""
    kept = model.noises if keep_white else tuple(q for q in model.noises if q not in on)
    names = ", ".join(q.name for q in on)
    beside = " beside the white noise" if keep_white else ""
    verb = "is a first-order Markov process" if len(on) == 1 else "are first-order Markov processes"
    return {
        "__doc__": f"{(type(model).__doc__ or '').rstrip()}\n\nThe noise {names} {verb}{beside}.",
        "__module__": __name__,
        "name": f"{model.name}_markov",
        "states": (*model.states, *(Quantity(f"xi_{q.name}", q.unit, f"Markov process: {_words(q)}") for q in on)),
        "inputs": model.inputs,
        "known_inputs": model.known_inputs,
        "noises": (*kept, *(Quantity(f"w_{q.name}", _per_second(q.unit), f"drives xi_{q.name}") for q in on)),
        "outputs": model.outputs,
        "performances": model.performances,
        "parameters": (
            *(replace(p, value=model.values[p.name]) for p in model.parameters),
            *(
                Parameter(f"tau_{q.name}", time_constants[q.name], "s", f"time constant of xi_{q.name}", "given")
                for q in on
            ),
        ),
        "sample_time": model.sample_time,
        "sample_time_parameter": model.sample_time_parameter,
        "discretisation": type(model).discretisation,
        "citation": model.citation,
        "latex_names": {
            **model.latex_names,
            **{f"{new}_{q.name}": rf"{tex}_{{\mathrm{{{_tex(q.name)}}}}}" for q in on for new, tex in _LATEX.items()},
        },
    }


_LATEX = {"xi": r"\xi", "w": "w", "tau": r"\tau"}


def _equations(model: Model, on: tuple[str, ...], keep_white: bool) -> dict[str, Any]:
    """The methods of the augmented model, on the checked equations of the given one."""
    import sympy as sp

    eq: Equations = model.equations()
    law = model.initial_law()
    force = {symbol(name): symbol(f"xi_{name}") + (symbol(name) if keep_white else 0) for name in on}

    def terms(self: Model, x: Any, u: Any, p: Any) -> Terms:
        out = Terms()
        for name, definition in eq.terms.items():
            out[str(name)] = definition
        return out

    def dynamics(self: Model, x: Symbols, u: Any, v: Symbols, p: Symbols) -> list[Any]:
        driven = [f.xreplace(force) for f in eq.dynamics]
        return driven + [step(self, x[f"xi_{n}"], v[f"w_{n}"], p[f"tau_{n}"]) for n in on]

    def step(self: Model, xi: Any, w: Any, tau: Any) -> Any:
        if self.discretisation != "discrete":
            return -xi / tau + w
        # The equations give the next state: the exact step over one sample time, w held.
        decay = sp.exp(-sp.Float(self.sample_time) / tau)
        return decay * xi + tau * (1 - decay) * w

    def initial_covariance(self: Model, p: Any) -> Any:
        return None if law is None else sp.diag(law, sp.zeros(len(on), len(on)))

    return {
        "terms": terms,
        "dynamics": dynamics,
        "output": lambda self, x, u, p: list(eq.output),
        "performance": lambda self, x, u, p: list(eq.performance),
        "initial_covariance": initial_covariance,
    }


def _words(q: Quantity) -> str:
    return q.description or q.name


def _per_second(unit: str) -> str:
    return "1/s" if unit in ("", "1") else f"{unit}/s"


def _tex(name: str) -> str:
    return name.replace("_", r"\_")

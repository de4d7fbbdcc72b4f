"""The law of the first state, and models that are simulated with white noise."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.pipeline.context import Context

if TYPE_CHECKING:
    from noiseid_cli.models.compiled import CompiledModel
    from noiseid_cli.models.equations import Model
    from noiseid_cli.models.recording import Array


def simulated(context: Context, Q: Array, R: Array) -> tuple[CompiledModel, Array, NoiseValues]:
    """The model as it is simulated, the covariance of its noise per sample, and the law of noise and first state.

    A model driven by white noise has the exact covariance over an interval, with a noise on each state.

    Args:
        context: an experiment that simulates.
        Q: (nv, nv) covariance of the process noise: per sample, or the spectral density of white noise.
        R: (ny, ny) covariance of the measurement noise.
    """
    model, section = context.model, context.experiment.simulate
    assert section is not None
    compiled = context.simulator
    if model.discretisation == "van_loan":
        compiled, Q = white(model, Q, R)
    T, own = selection(model), own_covariance(model)
    b = np.zeros(T.shape[1]) if section.initial_state is None else np.array(section.initial_state)
    drawn = section.initial_covariance
    P0 = own if drawn is None else T @ drawn.matrix() @ T.T + own
    return compiled, Q, NoiseValues(Q, R, (T @ b)[None], P0)


def white(model: Model, density: Array, R: Array) -> tuple[CompiledModel, Array]:
    """A linear model driven by white noise as a discrete one at its own sample time, and its covariance per step."""
    from noiseid_cli.models.linear_family import LinearFamily
    from noiseid_cli.models.recording import Recording

    nu, ny, dt = len(model.inputs), len(model.outputs), model.sample_time
    blank = Recording("blank", np.array([dt]), np.zeros((2, nu)), np.full((2, ny), np.nan))
    found = LinearFamily(model, (), density, R).filter_model(np.empty(0), [blank])
    assert found is not None  # there is one interval
    compiled, Q = found
    groups = {"states": model.states, "inputs": model.inputs, "outputs": model.outputs}
    names = {key: tuple(q.name for q in group) for key, group in groups.items()}
    return replace(compiled, name=model.name, **names), Q  # type: ignore[arg-type]


def selection(model: Model) -> Array:
    """(nx, nb) map from the free part of the first state: the columns of those states that the model leaves free."""
    free = {q.name for q in model.free_first_states}
    T: Array = np.eye(len(model.states))[:, [q.name in free for q in model.states]]
    return T


def own_covariance(model: Model) -> Array:
    """(nx, nx) covariance of the part of the first state that the model gives, at its parameter values."""
    law = model.initial_law()
    if law is None:
        return np.zeros((len(model.states), len(model.states)))
    values = {symbol: model.values[str(symbol)] for symbol in law.free_symbols}
    return np.array(law.subs(values).tolist(), dtype=float)


def first_names(context: Context) -> tuple[str, ...]:
    """What the initial mean and covariance of the ``estimate`` section are about."""
    section = context.experiment.estimate
    if section is not None and section.initial_map is not None:
        return tuple(section.initial_map.names)
    return tuple(q.name for q in context.model.free_first_states)

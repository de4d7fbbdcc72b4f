"""Inputs whose values come with the model, put beside those of a recording or a trajectory."""

from __future__ import annotations

import numpy as np

from noiseid_cli.errors import ModelError
from noiseid_cli.models.equations import Model
from noiseid_cli.models.recording import Array


def with_known_inputs(model: Model, u: Array, where: str) -> Array:
    """All inputs of a test, in the model's order.

    Args:
        model: the model.
        u: (N, driven) the inputs that do not come with the model, in the order of ``model.driven_inputs``.
        where: the test, for the error's text.

    Returns:
        (N, nu) inputs; ``u`` itself where the model brings none.

    Raises:
        ModelError: the model's values are of another number of samples.
    """
    if not model.known_inputs:
        return u
    for name, values in model.known_inputs.items():
        if len(values) != len(u):
            raise ModelError(
                f"{where} has {len(u)} samples, but {name}, which comes with the model, has {len(values)}: "
                "one matrix a sample is needed"
            )
    driven = iter(u.T)
    columns = [model.known_inputs[q.name] if q.name in model.known_inputs else next(driven) for q in model.inputs]
    return np.ascontiguousarray(np.column_stack(columns))

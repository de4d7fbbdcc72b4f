"""How far a filter's performance output (such as a tool position) is from the true one."""

from __future__ import annotations

import numpy as np
from numba import types

from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.jit import kernel
from noiseid_cli.models.recording import Array, Recording
from noiseid_cli.models.signatures import Output, matrix, vector


def performance_error(model: CompiledModel, recording: Recording, m: Array) -> Array:
    """(N, nz) performance output of the estimated states minus the true one, in the output's unit.

    Args:
        model: a model with a performance output.
        recording: a test whose true one is known; NaN there is NaN in the result.
        m: (N, nx) estimated states.
    """
    assert model.performance is not None
    assert recording.z_true is not None
    error = np.empty((recording.samples, model.nz))
    _performance(model.performance, model.parameters, np.ascontiguousarray(recording.u), np.ascontiguousarray(m), error)
    error -= recording.z_true
    return error


def path_error(model: CompiledModel, recording: Recording, m: Array) -> Array:
    """(N,) distance between the true performance output and that of the estimated states.

    For a tool position this is e_k of axelsson2011_poster, step V: sqrt(|x - x^|^2 + |y - y^|^2).
    Arguments as in ``performance_error``.
    """
    return np.asarray(np.linalg.norm(performance_error(model, recording, m), axis=1))


@kernel(types.void(Output, vector, matrix, matrix, matrix))
def _performance(output, p, u, m, z):  # type: ignore[no-untyped-def]
    """Write the performance output of each state to z."""
    for k in range(m.shape[0]):
        output(m[k], u[k], p, z[k])

"""Simulation of a recorded test anew: the recorded inputs in open loop, noise drawn from given covariances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from noiseid_cli.errors import DataError
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.discretisation import workspace
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording
from noiseid_cli.simulation.rollout import advance
from noiseid_cli.simulation.simulate import covariance_factor


def replay(
    model: CompiledModel, recording: Recording, noise: NoiseValues, test: int, rng: np.random.Generator
) -> Recording:
    """The recording as it might have been, with first state, process and measurement noise drawn anew.

    Draws standard normals in this order: the first state, the process noise, the measurement noise. Outputs that were
    missing are missing again. Inputs are those recorded: a controller that fed outputs back does not act.

    Args:
        model, recording: the model and the test.
        noise: covariances; row ``test`` of ``noise.m0`` is the mean of the first state.
        test: number of the test.
        rng: source of the draws.

    Raises:
        DataError: the state leaves the finite numbers, as that of an unstable system without its controller may.
    """
    N, p, u = recording.samples, model.parameters, np.ascontiguousarray(recording.u)
    x = noise.m0[test] + covariance_factor("initial_covariance", noise.P0, model.nx) @ rng.normal(size=model.nx)
    v = rng.normal(size=(N - 1, model.nv)) @ covariance_factor("process_noise", noise.Q, model.nv).T
    e = rng.normal(size=(N, model.ny)) @ covariance_factor("measurement_noise", noise.R, model.ny).T
    states, y, x_next = np.empty((N, model.nx)), np.empty((N, model.ny)), np.empty(model.nx)
    z = None if model.performance is None else np.empty((N, model.nz))
    F, G = np.empty((model.nx, model.nx)), np.empty((model.nx, model.nv))
    work = workspace(model.nx, model.nv)
    for k in range(N):
        states[k] = x
        model.output(x, u[k], p, y[k])
        if model.performance is not None and z is not None:
            model.performance(x, u[k], p, z[k])
        if k < N - 1:
            advance(model.scheme, model.drift_jacobian, x, u[k], v[k], float(recording.dt[k]), p, x_next, F, G, work)
            if not np.isfinite(x_next).all():
                raise DataError(
                    f"test {recording.name!r}: simulated in open loop, the state is no longer finite at sample {k + 2} "
                    f"of {N}: the system is not stable without its controller"
                )
            x = x_next.copy()
    y += e
    y[np.isnan(recording.y)] = np.nan
    return replace(recording, y=y, x_true=states, z_true=z)

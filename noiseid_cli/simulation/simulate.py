"""Datasets of simulated tests, with the truth behind them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from noiseid_cli.errors import DataError
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.declarations import Parameter, Quantity
from noiseid_cli.models.equations import Model
from noiseid_cli.models.recording import Array, Dataset, Recording
from noiseid_cli.simulation.motions import Plan
from noiseid_cli.simulation.parameter_changes import ParameterChange, parameters_over_time
from noiseid_cli.simulation.rollout import rollout

STREAM = 0
"""First entry of the spawn key of every random stream of a simulation."""

HELD_OUT = 1
"""The same for tests that are held out."""


def simulate(
    model: Model,
    compiled: CompiledModel,
    plan: Plan,
    Q: Array,
    R: Array,
    *,
    seed: int,
    samples: int,
    tests: int = 1,
    replicate: int = 0,
    x0: Array | None = None,
    P0: Array | None = None,
    name: str = "simulated",
    stream: int = STREAM,
    changes: Sequence[ParameterChange] = (),
    first_output: bool = True,
) -> Dataset:
    """Simulate tests that differ in their noise only.

    Test i of a replicate draws from PCG64(SeedSequence(seed, spawn_key=(stream, replicate, i))), i from 0, in this
    order: standard normals for v, then for e, then for the first state. It thus depends on no other test or replicate.

    Args:
        model: names and units for the dataset, and the sample time.
        compiled: the model's functions, at the same parameter values.
        plan: the motion, made ready for as many samples.
        Q: (nv, nv) covariance of the process noise per sample; may be semidefinite.
        R: (ny, ny) covariance of the measurement noise; may be semidefinite.
        seed: seed of the experiment.
        samples: number of samples N of each test.
        tests: number of tests.
        replicate: number of the Monte Carlo replicate.
        x0: (nx,) mean of the first state; None for the plan's.
        P0: (nx, nx) covariance of the first state; None for a first state equal to its mean.
        name: label of the dataset.
        stream: family of random streams, ``STREAM`` or ``HELD_OUT``.
        changes: of the model's parameters, in every test; the dataset then carries the true values over time.
        first_output: outputs are measured at the first sample too; else one interval later for the first time.

    Raises:
        ModelError: a change names no parameter of the model.
        DataError: a covariance has the wrong shape or a negative eigenvalue, or the state leaves the finite numbers.
    """
    if samples < 1 or tests < 1:
        raise DataError(f"a simulation needs at least one sample and one test, not {samples} and {tests}.")
    chol_Q = covariance_factor("process_noise", Q, compiled.nv)
    chol_R = covariance_factor("measurement_noise", R, compiled.ny)
    chol_P0 = np.zeros((compiled.nx, compiled.nx))
    if P0 is not None:
        chol_P0 = covariance_factor("initial_covariance", P0, compiled.nx)
    mean = plan.x0 if x0 is None else np.asarray(x0, dtype=float)
    if mean.shape != (compiled.nx,):
        raise DataError(f"the first state has the shape {mean.shape}; {model.name} has {compiled.nx} states.")
    dt = model.sample_time
    parameters = parameters_over_time(model, changes, samples) if changes else None
    recordings = []
    for test in range(tests):
        rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(stream, replicate, test))))
        v = rng.standard_normal((samples - 1, compiled.nv)) @ chol_Q.T
        e = rng.standard_normal((samples, compiled.ny)) @ chol_R.T
        if not first_output:
            e[0] = np.nan
        first = mean + chol_P0 @ rng.standard_normal(compiled.nx)
        label = f"test {test + 1}"
        out = rollout(compiled, plan.controller, first, v, e, dt, label, parameters)
        recordings.append(
            Recording(
                name=label,
                dt=np.full(samples - 1, dt),
                u=out.u,
                y=out.y,
                x_true=out.x,
                z_true=out.z if compiled.nz else None,
                parameters_true=parameters,
            )
        )
    return Dataset(
        name=name,
        model=model.name,
        recordings=tuple(recordings),
        inputs=_columns(model.inputs),
        outputs=_columns(model.outputs),
        states=_columns(model.states),
        performances=_columns(model.performances),
        parameters=_columns(model.parameters) if changes else (),
        Q_true=np.array(Q, dtype=float),
        R_true=np.array(R, dtype=float),
    )


def covariance_factor(what: str, C: Array, n: int) -> Array:
    """A square matrix L with C = L L'.

    It is the Cholesky factor of a definite C, else the symmetric root V sqrt(D) V' from the eigenvalues D, of which
    those within rounding of zero (n eps times the largest) count as zero.

    Args:
        what: name of the covariance, for error texts.
        C: (n, n) symmetric, positive semidefinite.
        n: the size that it must have.

    Raises:
        DataError: wrong shape, not finite, not symmetric, or a negative eigenvalue.
    """
    C = np.asarray(C, dtype=float)
    if C.shape != (n, n):
        raise DataError(f"{what} has the shape {C.shape}; it must be ({n}, {n}).")
    if not np.isfinite(C).all() or not np.allclose(C, C.T, rtol=1e-12, atol=0.0):
        raise DataError(f"{what} is not a finite symmetric matrix.")
    try:
        return np.asarray(np.linalg.cholesky(C), dtype=np.float64)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(C)
    smallest = float(values.min())
    if smallest < -n * np.finfo(float).eps * float(np.abs(values).max()):
        raise DataError(f"{what} is not positive semidefinite: its smallest eigenvalue is {smallest:.3g}.")
    factor: Array = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    return factor


def _columns(group: Sequence[Quantity | Parameter]) -> tuple[tuple[str, str, str], ...]:
    return tuple((q.name, q.unit, q.description) for q in group)

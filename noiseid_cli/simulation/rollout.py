"""Closed-loop simulation of one test of a compiled model.

Order of things at sample k, with y_k = h(x_k, u_k) + e_k and u_k held until sample k + 1: the outputs that the
controller reads are measured first, the controller sets u_k, the full y_k is taken with that u_k, and the state
moves on. So an output that the controller reads must not depend on u_k; that is checked at each sample, by
comparing its value before and after u_k is known. All other outputs may have feedthrough of u_k.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numba import types

from noiseid_cli.errors import DataError
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.discretisation import transition, workspace
from noiseid_cli.models.jit import kernel
from noiseid_cli.models.recording import Array
from noiseid_cli.models.signatures import DriftJacobian, f8, matrix, vector


class Controller(Protocol):
    """Sets the inputs of a simulation."""

    @property
    def reads(self) -> tuple[int, ...]:
        """Indices of the outputs that it reads."""

    def start(self) -> None:
        """Forget the last test."""

    def control(self, k: int, y: Array) -> Array:
        """(nu,) input at sample k, given the (ny,) outputs of that sample; NaN in those it does not read."""


@dataclass(frozen=True)
class Rollout:
    """One simulated test.

    Attributes:
        x: (N, nx) states.
        u: (N, nu) inputs.
        y: (N, ny) outputs with measurement noise.
        z: (N, nz) performance outputs.
    """

    x: Array
    u: Array
    y: Array
    z: Array


@kernel(types.void(types.int64, DriftJacobian, vector, vector, vector, f8, vector, vector, matrix, matrix, vector))
def advance(scheme, jacobian, x, u, v, dt, p, x_next, F, G, work):  # type: ignore[no-untyped-def]
    """x_next = F1(x, u) + F2(x, u) v (axelsson2011_poster, eq. 1a)."""
    transition(scheme, jacobian, x, u, dt, p, x_next, F, G, work)
    for i in range(x.size):
        for j in range(v.size):
            x_next[i] += G[i, j] * v[j]


def rollout(
    compiled: CompiledModel,
    controller: Controller,
    x0: Array,
    v: Array,
    e: Array,
    dt: float,
    label: str = "test",
    parameters: Array | None = None,
) -> Rollout:
    """Simulate one test.

    Args:
        compiled: the model.
        controller: sets u_k; it is started anew.
        x0: (nx,) first state.
        v: (N-1, nv) process noise of each interval.
        e: (N, ny) measurement noise of each sample.
        dt: interval, s.
        label: name of the test, for error texts.
        parameters: (N, np) parameter values at each sample, each held until the next; None for the model's own.

    Raises:
        DataError: the state leaves the finite numbers, or the controller reads an output that depends on the input
            it sets.
    """
    N, p = len(e), np.array(compiled.parameters)
    out = Rollout(
        x=np.empty((N, compiled.nx)),
        u=np.zeros((N, compiled.nu)),
        y=np.empty((N, compiled.ny)),
        z=np.empty((N, compiled.nz)),
    )
    x, u = np.array(x0, dtype=float), np.zeros(compiled.nu)
    x_next, h = np.empty(compiled.nx), np.empty(compiled.ny)
    F, G = np.empty((compiled.nx, compiled.nx)), np.empty((compiled.nx, compiled.nv))
    work = workspace(compiled.nx, compiled.nv)
    reads = list(controller.reads)
    controller.start()
    for k in range(N):
        if not np.isfinite(x).all():
            raise _diverged(compiled, label, k, dt, out.x)
        if parameters is not None:
            p[:] = parameters[k]
        seen = np.full(compiled.ny, np.nan)
        if reads:
            compiled.output(x, u, p, h)
            seen[reads] = h[reads] + e[k, reads]
        u = np.ascontiguousarray(controller.control(k, seen), dtype=float)
        compiled.output(x, u, p, h)
        out.x[k], out.u[k], out.y[k] = x, u, h + e[k]
        if reads and not np.array_equal(out.y[k, reads], seen[reads], equal_nan=True):
            raise _loop(compiled, controller, k, out.y[k], seen)
        if compiled.performance is not None:
            compiled.performance(x, u, p, out.z[k])
        if k < N - 1:
            advance(compiled.scheme, compiled.drift_jacobian, x, u, v[k], dt, p, x_next, F, G, work)
            x[:] = x_next
    return out


def _diverged(compiled: CompiledModel, label: str, k: int, dt: float, x: Array) -> DataError:
    last = ", ".join(f"{name} = {value:.4g}" for name, value in zip(compiled.states, x[k - 1], strict=True))
    return DataError(
        f"{label}: the simulated state is no longer finite at sample {k} (t = {k * dt:.6g} s); the last finite state "
        f"is {last}. Take a smaller process noise or input, or a shorter sample time."
        if k
        else f"{label}: the first state is not finite; give each state a number."
    )


def _loop(compiled: CompiledModel, controller: Controller, k: int, y: Array, seen: Array) -> DataError:
    names = [compiled.outputs[i] for i in controller.reads if y[i] != seen[i]]
    return DataError(
        f"the controller reads {', '.join(names)}, which depends on the input that it sets (sample {k}); "
        "let it read outputs without direct feedthrough only."
    )

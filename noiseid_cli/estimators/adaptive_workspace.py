"""What the adaptive filter keeps, and how it is handed over to its kernel."""

# ruff: noqa: N815 - fields carry the paper's letters
from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import types

from noiseid_cli.filters.ekf import cube
from noiseid_cli.filters.gram_schmidt import width
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.discretisation import workspace
from noiseid_cli.models.handle import handle_type, new
from noiseid_cli.models.jit import kernel
from noiseid_cli.models.recording import Array
from noiseid_cli.models.signatures import DriftJacobian, OutputJacobian, matrix, vector


class Workspace(NamedTuple):
    """All that the filter reads, what it keeps from sample to sample, and its scratch.

    n states, nv noises, ny outputs, p unknowns, of which the last nz - n are parameters. Kept: u_before, x, U,
    their derivatives dx (p, n), dU (p, n, n), dP; theta, the factors UT of Theta and UD of Delta; the open-loop
    sensitivity (p, n); the monitor's deques, a posteriori first and open-loop second; counts.
    """

    p: Array  # values of the stacked model's parameters
    weights: Array  # eta, outer, cov0, forgetting
    UR: Array
    free: Array  # index of each free variance of Q
    lower: Array  # (p,) bounds of the unknowns
    upper: Array
    thresholds: Array
    u_before: Array  # (nu,) input before the next sample
    x: Array
    U: Array
    dx: Array
    dU: Array
    dP: Array
    theta: Array
    UT: Array
    UD: Array
    open_loop: Array
    gate: Array  # (p,) 1 open, 0 closed
    excited: Array  # (p,) what the gate decided on
    excited_open: Array
    peaks: Array  # (2, p, n, c)
    peak_steps: Array
    peak_ends: Array  # (2, p, n, 2)
    counts: Array  # samples, corrections stacked, then (p,) projections
    UQ: Array
    x_new: Array
    U_new: Array
    X: Array
    dX: Array
    X_next: Array
    dX_next: Array
    Y: Array
    dY: Array
    y_hat: Array
    dy: Array  # (p, ny)
    psi: Array  # (ny, p)
    e: Array
    UR_seen: Array
    observed: Array
    Uyy: Array
    B: Array
    K: Array
    dK: Array
    z: Array
    z_next: Array
    F: Array
    Gz: Array
    H: Array
    G: Array
    dG: Array
    noise: Array
    QG: Array
    T: Array
    A: Array
    gain_z: Array
    gain_next: Array
    gain_F: Array
    gain_G: Array
    rpem_A: Array
    rpem_L: Array
    rpem_S: Array
    stack: Array
    w: Array
    d: Array
    work: Array
    gain_work: Array


_KINDS = {
    vector: "p weights lower upper thresholds u_before x theta gate excited excited_open x_new y_hat e z z_next gain_z "
    "gain_next w d work gain_work",
    cube: "dU dP dX dX_next dY dK",
    types.int64[::1]: "free counts observed",
    types.float64[:, :, :, ::1]: "peaks",
    types.int64[:, :, :, ::1]: "peak_steps peak_ends",
}
_KIND = {name: kind for kind, names in _KINDS.items() for name in names.split()}  # all others are matrices
_WORKSPACE = types.NamedTuple(tuple(_KIND.get(name, matrix) for name in Workspace._fields), Workspace)

HANDLE = handle_type(
    scheme=types.int64,
    drift_jacobian=DriftJacobian,
    gain_varies=types.boolean,
    gain_jacobian=DriftJacobian,
    output_jacobian=OutputJacobian,
    window=types.int64,
    workspace=_WORKSPACE,
)


@kernel(
    HANDLE(types.int64, DriftJacobian, types.boolean, DriftJacobian, OutputJacobian, types.int64, _WORKSPACE),
    allocates=True,
)
def prepare(scheme, drift_jacobian, gain_varies, gain_jacobian, output_jacobian, window, workspace):  # type: ignore[no-untyped-def]
    """The handle for ``adaptive_kernel.run``.

    Args:
        scheme, drift_jacobian, output_jacobian: the stacked model's, see ``models.stacked``.
        gain_varies, gain_jacobian: whether F2 depends on x or theta, and the model with gains as states.
        window: see ``excitation``.
        workspace: see ``Workspace``.
    """
    handle = new(HANDLE)
    handle.scheme = scheme
    handle.drift_jacobian = drift_jacobian
    handle.gain_varies = gain_varies
    handle.gain_jacobian = gain_jacobian
    handle.output_jacobian = output_jacobian
    handle.window = window
    handle.workspace = workspace
    return handle


def new_workspace(
    stacked: CompiledModel, gains: CompiledModel | None, n: int, p: int, free: int, window: int
) -> Workspace:
    """Zeros of all shapes.

    Args:
        stacked: the model with its parameters as states; gains: with its noise gains as states too, if they vary.
        n, p, free: number of states, of unknowns, and of the variances among them.
        window: number of samples that the monitor keeps.
    """
    nz, nv, ny = stacked.nx, stacked.nv, stacked.ny
    points, wide, c, ng = 2 * n + 1, max(n, ny, p), max(window, 1), 1 if gains is None else gains.nx
    shapes = {
        "p": len(stacked.parameters), "weights": 4, "UR": (ny, ny), "lower": p, "upper": p, "thresholds": p,
        "u_before": stacked.nu,
        "x": n, "U": (n, n), "dx": (p, n), "dU": (p, n, n), "dP": (p, n, n), "theta": p, "UT": (p, p), "UD": (ny, ny),
        "open_loop": (p, n), "gate": p, "excited": p, "excited_open": p, "peaks": (2, p, n, c), "UQ": (nv, nv),
        "x_new": n, "U_new": (n, n), "X": (points, n), "dX": (p, points, n), "X_next": (points, n),
        "dX_next": (p, points, n), "Y": (points, ny), "dY": (p, points, ny), "y_hat": ny, "dy": (p, ny),
        "psi": (ny, p), "e": ny, "UR_seen": (ny, ny), "Uyy": (ny, ny), "B": (n, ny), "K": (n, ny),
        "dK": (2, n, ny), "z": nz, "z_next": nz, "F": (nz, nz), "Gz": (nz, nv), "H": (ny, nz), "G": (n, nv),
        "dG": (n, nv), "noise": (nv, n), "QG": (nv, n), "T": (max(n, ny), max(n, ny)), "A": (n, n), "gain_z": ng,
        "gain_next": ng, "gain_F": (ng, ng), "gain_G": (ng, nv), "rpem_A": (p, ny), "rpem_L": (p, ny),
        "rpem_S": (ny, ny), "stack": (wide, width(max(2 * n + 1 + max(ny, nv), p + ny))), "w": wide, "d": wide,
    }  # fmt: skip
    integers = {"peak_steps": (2, p, n, c), "peak_ends": (2, p, n, 2), "counts": 2 + p, "observed": ny, "free": free}
    arrays: dict[str, Any] = {name: np.zeros(shape) for name, shape in shapes.items()}
    arrays |= {name: np.zeros(shape, dtype=np.int64) for name, shape in integers.items()}
    arrays |= {"work": workspace(nz, nv), "gain_work": workspace(ng, nv)}
    return Workspace(**arrays)

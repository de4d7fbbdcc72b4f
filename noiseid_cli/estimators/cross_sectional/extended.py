"""A test of a nonlinear model as a linear one: the model taken along the path that the smoother finds.

    x_{k+1} = A_k x_k + (f(x^_k, u_k) - A_k x^_k) + G_k v_k,   y_k = C_k x_k + (h(x^_k, u_k) - C_k x^_k) + e_k

with x^ the smoothed path of the extended Kalman smoother. The offsets stand in the input and in the output, so that the
methods for ensembles run as they are (porter1983_partitioned_recursive, section 6, first open question).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import types

from noiseid_cli.filters.ekf import cube
from noiseid_cli.filters.smoother import extended_kalman_smoother, filter_to_smooth
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.discretisation import transition, workspace
from noiseid_cli.models.jit import kernel
from noiseid_cli.models.linear_family import LinearFamily
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.parametric import ParametricMatrices
from noiseid_cli.models.recording import Array, Recording
from noiseid_cli.models.signatures import DriftJacobian, OutputJacobian, matrix, vector


@dataclass(frozen=True)
class Linearised:
    """One test along its path: pseudo-inputs and outputs less their offsets, and the matrices at given variances."""

    recording: Recording
    matrices: Callable[[Array], ParametricMatrices]


def linearised(model: CompiledModel, family: LinearFamily, recording: Recording, noise: NoiseValues) -> Linearised:
    """Linearise one test about its smoothed path.

    Args:
        model: the compiled equations.
        family: says which variances of Q and R are the alpha; its model parameters are not among them.
        recording: the test.
        noise: values for the smoother; m0 has one row.

    Raises:
        FilterDivergedError: the filter fails; names test and sample.
    """
    path = extended_kalman_smoother(filter_to_smooth(model, recording, noise)).m
    N, nx, nv, ny = recording.samples, model.nx, model.nv, model.ny
    A, G, offset = np.empty((N - 1, nx, nx)), np.empty((N - 1, nx, nv)), np.zeros((N, nx))
    C, h = np.empty((N, ny, nx)), np.empty((N, ny))
    _along(
        model.scheme, model.drift_jacobian, model.output_jacobian, np.ascontiguousarray(path),
        np.ascontiguousarray(recording.u), recording.dt, model.parameters, A, G, offset, C, h,
    )  # fmt: skip
    shifted = Recording(recording.name, recording.dt, offset, recording.y - h)

    def matrices(alpha: Array) -> ParametricMatrices:
        return _matrices(family, alpha, A, G, C)

    return Linearised(shifted, matrices)


def _matrices(family: LinearFamily, alpha: Array, A: Array, G: Array, C: Array) -> ParametricMatrices:
    Q, R = family.noise(alpha)
    na, nx, ny = len(alpha), A.shape[1], C.shape[1]
    dQ, dR = np.zeros((na, len(A), nx, nx)), np.zeros((na, 1, ny, ny))
    for k, i in enumerate(family.process):
        dQ[k] = G[:, :, i, None] * G[:, None, :, i]
    for k, i in enumerate(family.measurement):
        dR[len(family.process) + k, 0, i, i] = 1.0
    none = np.zeros((na, 1, nx, nx))
    D = np.zeros((1, ny, nx))
    return ParametricMatrices(
        A=A, B=np.eye(nx)[None], Q=G @ Q @ G.transpose(0, 2, 1), C=C, D=D, R=R[None], S_a=np.zeros((nx, nx)),
        dA=np.zeros((na, *A.shape)), dB=none, dQ=dQ, dC=np.zeros((na, *C.shape)), dD=np.zeros((na, *D.shape)), dR=dR,
        dS_a=none[:, 0],
    )  # fmt: skip


@kernel(
    types.void(
        types.int64, DriftJacobian, OutputJacobian, matrix, matrix, vector, vector, cube, cube, matrix, cube, matrix
    ),
    allocates=True,
)
def _along(scheme, drift, output, path, u, dt, p, A, G, offset, C, h):  # type: ignore[no-untyped-def]
    """Matrices and offsets of every interval and sample; h becomes h(x^) - C x^."""
    N, nx = path.shape
    work = workspace(nx, G.shape[2])
    for k in range(N):
        output(path[k], u[k], p, h[k], C[k])
        for i in range(h.shape[1]):
            for j in range(nx):
                h[k, i] -= C[k, i, j] * path[k, j]
        if k < N - 1:
            transition(scheme, drift, path[k], u[k], dt[k], p, offset[k], A[k], G[k], work)
            for i in range(nx):
                for j in range(nx):
                    offset[k, i] -= A[k, i, j] * path[k, j]

"""Linear models with constant matrices: x_{k+1} = A x_k + B u_k + G v_k, y_k = C x_k + D u_k + e_k.

The matrices travel as the parameter vector, so that one set of compiled functions serves every linear model.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from noiseid_cli.errors import ModelError
from noiseid_cli.models.compiled import Adjoints, CompiledModel
from noiseid_cli.models.jit import equation, routine
from noiseid_cli.models.recording import Array
from noiseid_cli.models.schemes import DISCRETE
from noiseid_cli.models.signatures import DRIFT, DRIFT_JACOBIAN, OUTPUT, OUTPUT_JACOBIAN


def linear_model(
    A: ArrayLike, G: ArrayLike, C: ArrayLike, B: ArrayLike | None = None, D: ArrayLike | None = None
) -> CompiledModel:
    """A discrete-time linear model.

    Args:
        A: (nx, nx) transition; G: (nx, nv) noise gain; C: (ny, nx) output map.
        B: (nx, nu) input gain and D: (ny, nu) feedthrough; without them the model has no input.

    Raises:
        ModelError: the shapes do not fit each other.
    """
    A, G, C = (np.atleast_2d(np.asarray(M, dtype=float)) for M in (A, G, C))
    nx, nv, ny = len(A), G.shape[1], len(C)
    nu = np.shape(B)[1] if B is not None else np.shape(D)[1] if D is not None else 0
    B = np.zeros((nx, nu)) if B is None else np.asarray(B, dtype=float)
    D = np.zeros((ny, nu)) if D is None else np.asarray(D, dtype=float)
    expected: dict[str, tuple[Array, tuple[int, int]]] = {
        "A": (A, (nx, nx)), "G": (G, (nx, nv)), "C": (C, (ny, nx)), "B": (B, (nx, nu)), "D": (D, (ny, nu))
    }  # fmt: skip
    for name, (M, shape) in expected.items():
        if M.shape != shape:
            raise ModelError(f"linear model: {name} has shape {M.shape}, expected {shape}")
    return CompiledModel(
        name="linear",
        states=tuple(f"x{i + 1}" for i in range(nx)),
        inputs=tuple(f"u{i + 1}" for i in range(nu)),
        noises=tuple(f"v{i + 1}" for i in range(nv)),
        outputs=tuple(f"y{i + 1}" for i in range(ny)),
        performances=(),
        units={},
        parameters=np.concatenate([M.ravel() for M in (A, B, G, C, D)]),
        scheme=DISCRETE,
        drift=_drift,
        drift_jacobian=_drift_jacobian,
        output=_output,
        output_jacobian=_output_jacobian,
        performance=None,
        performance_jacobian=None,
        load_adjoints=_adjoints,
    )


def _adjoints() -> Adjoints:
    """Compiled, or read from the cache, for those methods only that ask for them."""
    from noiseid_cli.models.linear_adjoint import drift_adjoint, output_adjoint

    return Adjoints(drift_adjoint, output_adjoint)


@routine
def _product(p, start, x, out):  # type: ignore[no-untyped-def]
    """Add M x to ``out``, the rows of M standing in p from ``start`` on."""
    rows, columns, start = np.uint64(out.size), np.uint64(x.size), np.uint64(start)
    for i in range(rows):
        total = out[i]
        for j in range(columns):
            total += p[start + i * columns + j] * x[j]
        out[i] = total


@routine
def _matrix(p, start, out):  # type: ignore[no-untyped-def]
    """Write the matrix that stands in p from ``start`` on to ``out``."""
    rows, columns, start = np.uint64(out.shape[0]), np.uint64(out.shape[1]), np.uint64(start)
    for i in range(rows):
        for j in range(columns):
            out[i, j] = p[start + i * columns + j]


@equation(DRIFT)
def _drift(x, u, v, p, dx):  # type: ignore[no-untyped-def]
    nx, nu = x.size, u.size
    dx[:] = 0.0
    _product(p, 0, x, dx)
    _product(p, nx * nx, u, dx)
    _product(p, nx * (nx + nu), v, dx)


@equation(DRIFT_JACOBIAN)
def _drift_jacobian(x, u, p, dx, F, Fv):  # type: ignore[no-untyped-def]
    nx, nu = x.size, u.size
    dx[:] = 0.0
    _product(p, 0, x, dx)
    _product(p, nx * nx, u, dx)
    _matrix(p, 0, F)
    _matrix(p, nx * (nx + nu), Fv)


@equation(OUTPUT)
def _output(x, u, p, y):  # type: ignore[no-untyped-def]
    nx, nu, ny = x.size, u.size, y.size
    y[:] = 0.0
    _product(p, p.size - ny * (nx + nu), x, y)
    _product(p, p.size - ny * nu, u, y)


@equation(OUTPUT_JACOBIAN)
def _output_jacobian(x, u, p, y, H):  # type: ignore[no-untyped-def]
    nx, nu, ny = x.size, u.size, y.size
    y[:] = 0.0
    _product(p, p.size - ny * (nx + nu), x, y)
    _product(p, p.size - ny * nu, u, y)
    _matrix(p, p.size - ny * (nx + nu), H)

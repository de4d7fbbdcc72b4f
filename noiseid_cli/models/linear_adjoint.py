"""The adjoints of a linear model with constant matrices, see ``ADJOINT`` in ``models.signatures``.

The parameter vector holds A, B, G, C, D row by row, as ``models.linear`` lays it out.
"""

from __future__ import annotations

from noiseid_cli.models.arrays import copy
from noiseid_cli.models.jit import equation
from noiseid_cli.models.signatures import ADJOINT


@equation(ADJOINT)
def drift_adjoint(x, u, p, w, gx, gp):  # type: ignore[no-untyped-def]
    """Derivatives of w . (A x + B u, A, G); w (nx + nx nx + nx nv,)."""
    nx, nu = x.size, u.size
    g = nx * (nx + nu)
    gx[:] = 0.0
    gp[:] = 0.0
    for i in range(nx):
        for j in range(nx):
            gx[j] += w[i] * p[i * nx + j]
            gp[i * nx + j] = w[i] * x[j] + w[nx + i * nx + j]
        for j in range(nu):
            gp[nx * nx + i * nu + j] = w[i] * u[j]
    copy(w[nx + nx * nx :], gp[g:])


@equation(ADJOINT)
def output_adjoint(x, u, p, w, gx, gp):  # type: ignore[no-untyped-def]
    """Derivatives of w . (C x + D u, C); w (ny + ny nx,)."""
    nx, nu = x.size, u.size
    ny = w.size // (1 + nx)
    d = p.size - ny * nu
    c = d - ny * nx
    gx[:] = 0.0
    gp[:] = 0.0
    for i in range(ny):
        for j in range(nx):
            gx[j] += w[i] * p[c + i * nx + j]
            gp[c + i * nx + j] = w[i] * x[j] + w[ny + i * nx + j]
        for j in range(nu):
            gp[d + i * nu + j] = w[i] * u[j]

"""The types of a compiled model's functions, as the kernels take them.

Kernels receive these as first-class function values, so that one compiled kernel serves every model and both
stay in numba's cache. All arrays are C-contiguous f8; each function writes every entry of its outputs.
"""

from __future__ import annotations

from numba import types

f8 = types.float64
vector = types.float64[::1]
matrix = types.float64[:, ::1]

# drift(x, u, v, p, dx): dx = f(x, u, v, p), or the next state for a discrete model.
DRIFT = types.void(vector, vector, vector, vector, vector)
# drift_jacobian(x, u, p, dx, A, B): f, A = df/dx and B = df/dv, all at v = 0.
DRIFT_JACOBIAN = types.void(vector, vector, vector, vector, matrix, matrix)
# output(x, u, p, y): y = h(x, u, p); a performance output z = g(x, u, p) has the same form.
OUTPUT = types.void(vector, vector, vector, vector)
# output_jacobian(x, u, p, y, H): h and H = dh/dx.
OUTPUT_JACOBIAN = types.void(vector, vector, vector, vector, matrix)

# adjoint(x, u, p, w, gx, gp): gx, gp = derivatives of w . z by x and p, where z are the results of drift_jacobian
# (dx, A, B) or of output_jacobian (y, H) in one row, matrices row by row.
ADJOINT = types.void(vector, vector, vector, vector, vector, vector)

Adjoint = types.FunctionType(ADJOINT)
DriftJacobian = types.FunctionType(DRIFT_JACOBIAN)
OutputJacobian = types.FunctionType(OUTPUT_JACOBIAN)
Drift = types.FunctionType(DRIFT)
Output = types.FunctionType(OUTPUT)

"""Derivatives of the sigma-point steps in parameters theta (riva2017_sensitivity_asrukf, Tables 1 and 2).

The paper's matrices with one block per parameter are arrays with the parameter in front. All is exact: a derivative
here is that of the number which ``sigma_steps`` computes, its gain included.
"""

from __future__ import annotations

import numpy as np

from noiseid_cli.filters.factors import factor_derivative
from noiseid_cli.filters.linalg import backward_solve, forward_solve
from noiseid_cli.models.jit import routine


@routine
def half_moment(X, x, dX, dx, m, outer, cov0, T):  # type: ignore[no-untyped-def]
    """T = sum_i w_i (dX_i - dx)(X_i - x)' over the first m columns; T + T' is the derivative of the covariance."""
    m, points = np.uint64(m), np.uint64(X.shape[0])
    for a in range(m):
        for b in range(m):
            T[a, b] = 0.0
    for i in range(points):
        weight = cov0 if i == 0 else outer
        for a in range(m):
            shift = weight * (dX[i, a] - dx[a])
            for b in range(m):
                T[a, b] += shift * (X[i, b] - x[b])


@routine
def condition_derivative(U, dU, dP, Y, y_hat, dY, dy, q, e, Uyy, K, eta, outer, cov0, U_new, dx, T, dK, A):  # type: ignore[no-untyped-def]
    """Derivative of ``sigma_steps.condition`` in one parameter; dx, dU and dP go from predicted to corrected.

    dPxy from the points' directions, dK = (dPxy - K dPyy) Pyy^-1, dx+ = dx - K dy^ + dK e,
    dP+ = dP - dPxy K' - K dPxy' + K dPyy K'.

    Args:
        U: predicted factor; dU, dP: (n, n) its derivative and the covariance's; overwritten.
        Y, y_hat: output points and mean, q observed columns first; dY, dy: their derivatives.
        e: innovation; Uyy, K, U_new: what ``condition`` gave.
        eta, outer, cov0: see ``sigma_points``.
        dx: (n,) derivative of the mean, overwritten.
        T: scratch (>= q, >= q); dK: scratch (2, n, >= q); A: scratch (n, n).
    """
    n = U.shape[0]
    dPxy, gain = dK[0], dK[1]
    half_moment(Y, y_hat, dY, dy, q, outer, cov0, T)
    for a in range(q):
        for b in range(a):
            T[a, b] += T[b, a]
            T[b, a] = T[a, b]
        T[a, a] *= 2.0
    for a in range(n):
        for b in range(q):
            total = 0.0
            for r in range(a + 1):
                total += dU[r, a] * (Y[1 + r, b] - Y[1 + n + r, b]) + U[r, a] * (dY[1 + r, b] - dY[1 + n + r, b])
            dPxy[a, b] = eta * outer * total
    for a in range(n):
        for b in range(q):
            gain[a, b] = dPxy[a, b]
            for c in range(q):
                gain[a, b] -= K[a, c] * T[c, b]
        forward_solve(Uyy, q, gain[a])
        backward_solve(Uyy, q, gain[a])
        for b in range(q - 1, -1, -1):
            dx[a] += gain[a, b] * e[b] - K[a, b] * dy[b]
    # Half of dP+ - dP is B = (K dPyy / 2 - dPxy) K'; the other half is its transpose.
    for a in range(n):
        for b in range(q):
            for c in range(q):
                dPxy[a, b] -= 0.5 * K[a, c] * T[c, b]
    for a in range(n):
        for b in range(a + 1):
            total = 0.0
            for c in range(q):
                total += dPxy[a, c] * K[b, c] + dPxy[b, c] * K[a, c]
            dP[a, b] -= total
            dP[b, a] = dP[a, b]
    factor_derivative(U_new, dP, dU, A)

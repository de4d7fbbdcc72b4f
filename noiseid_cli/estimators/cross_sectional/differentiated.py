"""A Kalman filter with its derivatives in parameters, run on several columns at once; all else here is built on it.

Columns share the gain. The first ones carry the data, a column a test: tests with equal matrices, length and missing
outputs have everything else in common. The ignorant filter of the partitioned method adds the columns -U, whose
"innovations" are then T_k = C U_k; the standard filter has none. Derivatives follow porter1983_partitioned_recursive,
eq. (29): at the optimal gain dP has no term in dK.

Results are whitened: with S = L L' an innovation nu leaves as L^-1 nu and dS as L^-1 dS L^-T, L not differentiated.
A missing output counts as one that sees nothing with unit noise, which changes no sum.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from noiseid_cli.estimators.cross_sectional.products import add, add_t, cholesky, t_add, unwhiten, whiten
from noiseid_cli.models.arrays import copy_cube, copy_matrix
from noiseid_cli.models.jit import allocating, kernel, routine
from noiseid_cli.models.signatures import matrix

cube = types.float64[:, :, ::1]
tesseract = types.float64[:, :, :, ::1]


@allocating
def update_scratch(nx, ny):  # type: ignore[no-untyped-def]
    """Matrices that ``update`` works in."""
    square, wide, small = np.empty((3, nx, nx)), np.empty((5, ny, nx)), np.empty((3, ny, ny))
    return (square[0], square[1], square[2], wide[0], wide[1], wide[2], wide[3], wide[4], small[0], small[1],
            small[2], np.empty((nx, ny)))  # fmt: skip


@routine
def update(P, dP, X, dX, C, dC, R, dR, G, dG, dS, K, L, scratch):  # type: ignore[no-untyped-def]
    """Measurement update of covariance and columns with derivatives.

    Args:
        P: (nx, nx), dP: (p, nx, nx), X: (nx, nc), dX: (p, nx, nc): overwritten.
        C: (ny, nx), dC: (na, ny, nx); R: (ny, ny), dR: (na, ny, ny); parameters from na on do not enter C and R.
        G: (ny, nc), dG: (p, ny, nc): innovations, overwritten by the whitened ones.
        dS: (p, ny, ny): written, whitened.
        K, L: (nx, ny), (ny, ny): written, the gain P C' S^-1 and the factor of S = L L'.
        scratch: from ``update_scratch``.

    Returns:
        log det S, NaN if S is not positive definite.
    """
    ny, nx = C.shape
    before, F, W, CP, V, Kt, dCP, dCPf, S, dSi, CPdC, KdR = scratch
    copy_matrix(P, before)
    copy_matrix(R, S)
    CP[:] = 0.0
    add(1.0, C, P, CP)
    add_t(1.0, CP, C, S)
    logdet = cholesky(S, L)
    if math.isnan(logdet):
        return logdet
    copy_matrix(CP, V)
    whiten(L, V)
    copy_matrix(V, Kt)
    unwhiten(L, Kt)
    copy_matrix(Kt.T, K)
    F[:] = 0.0
    for r in range(nx):
        F[r, r] = 1.0
    add(-1.0, K, C, F)
    t_add(-1.0, V, V, P)  # P_f = P - P C' S^-1 C P
    for i in range(dP.shape[0]):
        dCP[:], dSi[:], W[:] = 0.0, 0.0, 0.0
        add(1.0, C, dP[i], dCP)
        add_t(1.0, dCP, C, dSi)
        add_t(1.0, dP[i], F, W)
        dP[i] = 0.0
        add(1.0, F, W, dP[i])  # dP_f = F dP F' - P_f dC' K' - K dC P_f + K dR K', F = I - K C
        if i < dC.shape[0]:
            CPdC[:], dCPf[:], KdR[:] = 0.0, 0.0, 0.0
            add_t(1.0, CP, dC[i], CPdC)
            for r in range(ny):
                for c in range(ny):
                    dSi[r, c] += CPdC[r, c] + CPdC[c, r] + dR[i, r, c]
            add(1.0, dC[i], before, dCP)
            add(1.0, dC[i], P, dCPf)
            W[:, :] = 0.0
            add(1.0, K, dCPf, W)
            for r in range(nx):
                for c in range(nx):
                    dP[i, r, c] -= W[r, c] + W[c, r]
            add(1.0, K, dR[i], KdR)
            add_t(1.0, KdR, K, dP[i])
        add(-1.0, dSi, Kt, dCP)
        whiten(L, dCP)
        unwhiten(L, dCP)  # dK' = S^-1 (d(C P) - dS K')
        t_add(1.0, dCP, G, dX[i])
        add(1.0, K, dG[i], dX[i])
        whiten(L, dG[i])
        whiten(L, dSi)
        copy_matrix(dSi.T, dS[i])
        whiten(L, dS[i])
    add(1.0, K, G, X)
    whiten(L, G)
    return logdet


@routine
def mask(y, C, dC, R, dR):  # type: ignore[no-untyped-def]
    """Make each missing output one that sees nothing with unit noise; y (ny, tests), missing in all tests alike."""
    for r in range(len(y)):
        if math.isnan(y[r, 0]):
            C[r] = 0.0
            dC[:, r] = 0.0
            R[r] = 0.0
            R[:, r] = 0.0
            R[r, r] = 1.0
            dR[:, r] = 0.0
            dR[:, :, r] = 0.0


@routine
def see(s, B, u, X):  # type: ignore[no-untyped-def]
    """Add s B u to the first columns of X; u (nu, tests)."""
    for r in range(B.shape[0]):
        for c in range(u.shape[0]):
            b = s * B[r, c]
            for t in range(u.shape[1]):
                X[r, t] += b * u[c, t]


@routine
def predict(A, B, Q, dA, dB, dQ, u, P, dP, X, dX, Z, Y, W, V, X_new, Z_new):  # type: ignore[no-untyped-def]
    """Time update of everything; dA, dB, dQ are those of one step, (na, ., .). The columns of data see the input u.

    W, V (nx, nx), X_new, Z_new like X and Z: scratch.
    """
    nx, na = len(A), len(dA)
    V[:] = 0.0
    add(1.0, A, P, V)
    for i in range(len(dP)):
        W[:], X_new[:] = 0.0, 0.0
        add(1.0, A, dP[i], W)
        dP[i] = 0.0
        add_t(1.0, W, A, dP[i])
        add(1.0, A, dX[i], X_new)
        if i < na:
            W[:] = 0.0
            add_t(1.0, V, dA[i], W)
            for r in range(nx):
                for c in range(nx):
                    dP[i, r, c] += W[r, c] + W[c, r] + dQ[i, r, c]
            add(1.0, dA[i], X, X_new)
            see(1.0, dB[i], u, X_new)
        copy_matrix(X_new, dX[i])
    copy_matrix(Q, P)
    add_t(1.0, V, A, P)
    X_new[:] = 0.0
    add(1.0, A, X, X_new)
    see(1.0, B, u, X_new)
    copy_matrix(X_new, X)
    if Z.shape[1] > 0:
        for i in range(na):
            Z_new[:] = 0.0
            add(1.0, dA[i], Z, Z_new)
            add(1.0, A, Y[i], Z_new)
            see(1.0, dB[i], u, Z_new)
            copy_matrix(Z_new, Y[i])
        Z_new[:] = 0.0
        add(1.0, A, Z, Z_new)
        see(1.0, B, u, Z_new)
        copy_matrix(Z_new, Z)


@routine
def innovate(y, u, C, D, dC, dD, X, dX, Z, Y, G, dG, g):  # type: ignore[no-untyped-def]
    """Innovations of all columns at one sample: G = data - C X with derivatives, g = d(C Z)/dalpha - C (taken in)."""
    na, tests, crossed = len(dC), y.shape[1], Z.shape[1] > 0
    G[:], dG[:], g[:] = 0.0, 0.0, 0.0
    add(-1.0, C, X, G)
    see(-1.0, D, u, G)
    for r in range(len(y)):
        for t in range(tests):
            G[r, t] += y[r, t]
    for i in range(len(dG)):
        add(-1.0, C, dX[i], dG[i])
        if i < na:
            add(-1.0, dC[i], X, dG[i])
            see(-1.0, dD[i], u, dG[i])
    if crossed:
        for i in range(na):
            add(1.0, C, Y[i], g[i])
            add(1.0, dC[i], Z, g[i])
            see(1.0, dD[i], u, g[i])
    for r in range(len(y)):
        if math.isnan(y[r, 0]):
            G[r, :tests], dG[:, r, :tests] = 0.0, 0.0
            if crossed:
                g[:, r, :tests] = 0.0


@kernel(
    types.Tuple((types.int64, types.float64))(
        cube, cube, cube, cube, cube, cube, tesseract, tesseract, tesseract, tesseract, tesseract, tesseract,
        cube, cube, matrix, cube, matrix, cube, matrix, cube, cube, tesseract, tesseract, tesseract,
    ),
    allocates=True,
)  # fmt: skip
def differentiated_filter(  # type: ignore[no-untyped-def]
    A, B, Q, C, D, R, dA, dB, dQ, dC, dD, dR, u, y, P, dP, X, dX, Z, Y, G, dG, dS, g
):
    """Run tests that share everything but u and y; na parameters enter the matrices, p >= na enter the start.

    Args:
        A, ..., dR: as in ``ParametricMatrices``.
        u: (N, nu, tests). y: (N, ny, tests), NaN where missing, in all tests alike.
        P, dP, X, dX: start covariance (nx, nx), columns (nx, nc) and derivatives (p, ...); overwritten.
        Z: (nx, nz) open-loop responses [to each u, to each b] at the start and Y: (na, nx, nz) their derivatives less
            what the filter has taken in; nz = 0 leaves them out. Overwritten.
        G: (N, ny, nc), dG: (p, N, ny, nc), dS: (p, N, ny, ny): written, whitened.
        g: (na, N, ny, nz): written, whitened innovations of the columns d(response)/dalpha.

    Returns:
        -1 and the sum of log det S, or the sample where S was not positive definite.
    """
    N, ny = y.shape[:2]
    nx, nc = X.shape
    p, na, nz = dP.shape[0], dA.shape[0], Z.shape[1]
    K, L, Gk = np.empty((nx, ny)), np.empty((ny, ny)), np.empty((ny, nc))
    dGk, dSk, gk = np.empty((p, ny, nc)), np.empty((p, ny, ny)), np.empty((na, ny, nz))
    Ck, dCk, Rk, dRk = np.empty((ny, nx)), np.empty((na, ny, nx)), np.empty((ny, ny)), np.empty((na, ny, ny))
    W, V, X_new, Z_new = np.empty((nx, nx)), np.empty((nx, nx)), np.empty((nx, nc)), np.empty((nx, nz))
    scratch = update_scratch(nx, ny)
    total = 0.0
    for k in range(N):
        c, d, r = min(k, C.shape[0] - 1), min(k, D.shape[0] - 1), min(k, R.shape[0] - 1)
        copy_matrix(C[c], Ck)
        copy_cube(dC[:, c], dCk)
        copy_matrix(R[r], Rk)
        copy_cube(dR[:, r], dRk)
        mask(y[k], Ck, dCk, Rk, dRk)
        innovate(y[k], u[k], Ck, D[d], dCk, dD[:, d], X, dX, Z, Y, Gk, dGk, gk)
        logdet = update(P, dP, X, dX, Ck, dCk, Rk, dRk, Gk, dGk, dSk, K, L, scratch)
        if math.isnan(logdet):
            return k, logdet
        total += logdet
        for i in range(na):
            add(-1.0, K, gk[i], Y[i])
            whiten(L, gk[i])
        copy_matrix(Gk, G[k])
        copy_cube(dGk, dG[:, k])
        copy_cube(dSk, dS[:, k])
        copy_cube(gk, g[:, k])
        if k < N - 1:
            a, b, q = min(k, A.shape[0] - 1), min(k, B.shape[0] - 1), min(k, Q.shape[0] - 1)
            predict(A[a], B[b], Q[q], dA[:, a], dB[:, b], dQ[:, q], u[k], P, dP, X, dX, Z, Y,
                    W, V, X_new, Z_new)  # fmt: skip
    return -1, total

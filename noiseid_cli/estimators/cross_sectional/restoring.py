"""The standard filter rebuilt from the ignorant one by a filter for b on top of it (porter1983, step 4; Friedland).

    nu = nu_I - T_k b_{k-1},  B = B_I + T_k M_{k-1} T_k'

b_{k-1} and M_{k-1} are the mean and covariance of b before measurement k.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import types

from noiseid_cli.estimators.cross_sectional.differentiated import cube, tesseract, update, update_scratch
from noiseid_cli.estimators.cross_sectional.ignorant import Whitened
from noiseid_cli.estimators.cross_sectional.products import add
from noiseid_cli.models.jit import kernel
from noiseid_cli.models.recording import Array
from noiseid_cli.models.signatures import matrix


def restored_information(run: Whitened, mu: Array, Sigma: Array) -> Array:
    """The alpha-alpha block (30), (na, na); mu (nb,) and Sigma (nb, nb) do not depend on alpha."""
    na, nb = len(run.dG), len(mu)
    return restore_bias(run, mu, Sigma, np.zeros((na, nb)), np.zeros((na, nb, nb))).information


@dataclass(frozen=True)
class RestoredBias:
    """What the bias-restoring filter gives for one test; p parameters, those of the matrices first.

    Attributes:
        nll: l of the test (26); gradient: (p,) (29); information: (p, p) (30).
        mean, covariance: (nb,), (nb, nb) of b given the test; dmean, dcovariance: (p, ...) their derivatives.
    """

    nll: float
    gradient: Array
    information: Array
    mean: Array
    covariance: Array
    dmean: Array
    dcovariance: Array


def restore_bias(run: Whitened, mean: Array, covariance: Array, dmean: Array, dcovariance: Array) -> RestoredBias:
    """Likelihood of one test with gradient and information in p parameters.

    Args:
        run: the ignorant filter's innovations, with na parameters.
        mean, covariance: (nb,), (nb, nb) law of b before the test.
        dmean, dcovariance: (p, nb), (p, nb, nb) its derivatives, p >= na, the parameters of ``run`` first.
    """
    N, ny = run.G.shape[:2]
    p = len(dmean)
    nu, dnu, dB = np.empty((N, ny, 1)), np.empty((p, N, ny, 1)), np.empty((p, N, ny, ny))
    M, dM, b, db = covariance.copy(), dcovariance.copy(), mean[:, None].copy(), dmean[:, :, None].copy()
    logdet = run.logdet + _restore(run.G, run.dG, run.dS, M, dM, b, db, nu, dnu, dB)
    return RestoredBias(*likelihood(logdet, nu, dnu, dB), expected_information(dnu, dB), b[:, 0], M, db[:, :, 0], dM)


def likelihood(logdet: float, nu: Array, dnu: Array, dB: Array) -> tuple[float, Array]:
    """(26) and its gradient (29) from whitened nu (N, ny, 1), dnu (p, N, ny, 1), dB (p, N, ny, ny)."""
    nll = 0.5 * (logdet + float(np.sum(nu * nu)))
    gradient = np.sum((dnu - 0.5 * dB @ nu) * nu, axis=(1, 2, 3)) + 0.5 * np.einsum("pknn->p", dB)
    return nll, gradient


def expected_information(dnu: Array, dB: Array) -> Array:
    """(30) from whitened derivatives dnu (p, N, ny, 1) and dB (p, N, ny, ny): 1/2 tr(dB dB) + dnu' dnu."""
    p, N, ny = dnu.shape[:3]
    dnu, dB = dnu.reshape(p, N * ny), dB.reshape(p, N * ny * ny)
    information: Array = 0.5 * dB @ dB.T + dnu @ dnu.T
    return information


@kernel(types.float64(cube, tesseract, tesseract, matrix, cube, matrix, cube, cube, tesseract, tesseract))
def _restore(G, dG, dS, M, dM, b, db, nu, dnu, dB):  # type: ignore[no-untyped-def]
    """Measurement updates of b alone; in whitened units the "measurement noise" is I, its derivative dS.

    M, dM, b, db are overwritten by those after the test. Returns the sum of log det B in whitened units.
    """
    N, ny, nc = G.shape
    nb, na, p = nc - 1, dG.shape[0], db.shape[0]
    K, L, unit = np.empty((nb, ny)), np.empty((ny, ny)), np.eye(ny)
    T, dT, dR = np.empty((ny, nb)), np.empty((na, ny, nb)), np.empty((na, ny, ny))
    dnuk, dBk = np.empty((p, ny, 1)), np.empty((p, ny, ny))
    scratch = update_scratch(nb, ny)
    total = 0.0
    for k in range(N):
        T[:], dT[:], dR[:] = G[k, :, 1:], dG[:, k, :, 1:], dS[:, k]
        nu[k, :, 0] = G[k, :, 0]
        add(-1.0, T, b, nu[k])
        dnuk[:] = 0.0
        for i in range(p):
            if i < na:
                dnuk[i, :, 0] = dG[i, k, :, 0]
                add(-1.0, dT[i], b, dnuk[i])
            add(-1.0, T, db[i], dnuk[i])
        total += update(M, dM, b, db, T, dT, unit, dR, nu[k], dnuk, dBk, K, L, scratch)
        dnu[:, k] = dnuk
        dB[:, k] = dBk
    return total

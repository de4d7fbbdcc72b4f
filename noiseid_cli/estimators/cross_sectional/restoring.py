"""The standard filter rebuilt from the ignorant one by a filter for b on top of it (porter1983, step 4; Friedland).

    nu = nu_I - T_k b_{k-1},  B = B_I + T_k M_{k-1} T_k'

b_{k-1} and M_{k-1} are the mean and covariance of b before measurement k.
"""

# ruff: noqa: N815 - derivatives carry the paper's letters
from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import types

from noiseid_cli.estimators.cross_sectional.differentiated import cube, tesseract, update, update_scratch
from noiseid_cli.estimators.cross_sectional.ignorant import Whitened
from noiseid_cli.estimators.cross_sectional.products import add
from noiseid_cli.models.arrays import copy_cube, copy_matrix
from noiseid_cli.models.jit import kernel
from noiseid_cli.models.recording import Array
from noiseid_cli.models.signatures import matrix


def restored_information(run: Whitened, mu: Array, Sigma: Array) -> Array:
    """The alpha-alpha blocks (30), (tests, na, na); mu (nb,) and Sigma (nb, nb) do not depend on alpha."""
    na, nb = len(run.dG), len(mu)
    r = _restored(run, mu, Sigma, np.zeros((na, nb)), np.zeros((na, nb, nb)))
    return expected_information(r.dnu, r.dB)


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
        run: the ignorant filter's innovations of that test, with na parameters.
        mean, covariance: (nb,), (nb, nb) law of b before the test.
        dmean, dcovariance: (p, nb), (p, nb, nb) its derivatives, p >= na, the parameters of ``run`` first.
    """
    r = _restored(run, mean, covariance, dmean, dcovariance)
    nll, gradient = likelihood(r.logdet, r.nu, r.dnu, r.dB)
    information = expected_information(r.dnu, r.dB)[0]
    return RestoredBias(nll, gradient, information, r.b[:, 0], r.M, r.db[:, :, 0], r.dM)


class _Restored(NamedTuple):
    """Whitened innovations nu (N, ny, tests) of the standard filter, and b after the tests, (nb, tests)."""

    logdet: float
    nu: Array
    dnu: Array
    dB: Array
    M: Array
    dM: Array
    b: Array
    db: Array


def _restored(run: Whitened, mean: Array, covariance: Array, dmean: Array, dcovariance: Array) -> _Restored:
    """Run the filter for b on every test from the same law of b."""
    N, ny = run.G.shape[:2]
    p, tests = len(dmean), run.tests
    nu, dnu, dB = np.empty((N, ny, tests)), np.empty((p, N, ny, tests)), np.empty((p, N, ny, ny))
    M, dM = covariance.copy(), dcovariance.copy()
    b, db = np.tile(mean[:, None], (1, tests)), np.tile(dmean[:, :, None], (1, 1, tests))
    logdet = run.logdet + _restore(run.G, run.dG, run.dS, M, dM, b, db, nu, dnu, dB)
    return _Restored(logdet, nu, dnu, dB, M, dM, b, db)


def likelihood(logdet: float, nu: Array, dnu: Array, dB: Array) -> tuple[float, Array]:
    """(26) and its gradient (29) from whitened nu (N, ny, 1), dnu (p, N, ny, 1), dB (p, N, ny, ny)."""
    nll = 0.5 * (logdet + float(np.sum(nu * nu)))
    gradient = np.sum((dnu - 0.5 * dB @ nu) * nu, axis=(1, 2, 3)) + 0.5 * np.einsum("pknn->p", dB)
    return nll, gradient


def expected_information(dnu: Array, dB: Array) -> Array:
    """(30) from whitened dnu (p, N, ny, tests) and dB (p, N, ny, ny): 1/2 tr(dB dB) + dnu' dnu, (tests, p, p)."""
    p, N, ny, tests = dnu.shape
    dB = dB.reshape(p, N * ny * ny)
    own = np.ascontiguousarray(dnu.reshape(p, N * ny, tests).transpose(2, 0, 1))
    information: Array = 0.5 * dB @ dB.T + own @ own.transpose(0, 2, 1)
    return information


@kernel(
    types.float64(cube, tesseract, tesseract, matrix, cube, matrix, cube, cube, tesseract, tesseract), allocates=True
)
def _restore(G, dG, dS, M, dM, b, db, nu, dnu, dB):  # type: ignore[no-untyped-def]
    """Measurement updates of b alone; in whitened units the "measurement noise" is I, its derivative dS.

    M, dM, b (nb, tests), db are overwritten by those after the tests. Returns the sum of log det B in whitened units.
    """
    N, ny = G.shape[:2]
    nb, tests = b.shape
    na, p = dG.shape[0], db.shape[0]
    K, L, unit = np.empty((nb, ny)), np.empty((ny, ny)), np.eye(ny)
    T, dT, dR = np.empty((ny, nb)), np.empty((na, ny, nb)), np.empty((na, ny, ny))
    dnuk, dBk = np.empty((p, ny, tests)), np.empty((p, ny, ny))
    scratch = update_scratch(nb, ny)
    total = 0.0
    for k in range(N):
        copy_matrix(G[k, :, tests:], T)
        copy_cube(dG[:, k, :, tests:], dT)
        copy_cube(dS[:, k], dR)
        copy_matrix(G[k, :, :tests], nu[k])
        add(-1.0, T, b, nu[k])
        dnuk[:] = 0.0
        for i in range(p):
            if i < na:
                copy_matrix(dG[i, k, :, :tests], dnuk[i])
                add(-1.0, dT[i], b, dnuk[i])
            add(-1.0, T, db[i], dnuk[i])
        total += update(M, dM, b, db, T, dT, unit, dR, nu[k], dnuk, dBk, K, L, scratch)
        copy_cube(dnuk, dnu[:, k])
        copy_cube(dBk, dB[:, k])
    return total

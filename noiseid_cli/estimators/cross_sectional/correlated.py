"""Tests that share a bias c, carried from one to the next (porter1983_partitioned_recursive, eq. 9 to 12, 20, 21).

(b, c) is one bias vector of a test. l of a test is conditional on the tests before it: c enters with the mean,
covariance and derivatives in all of theta that they left. Derivatives are counted alpha first, then mu, then Sigma.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from noiseid_cli.errors import ModelError
from noiseid_cli.estimators.cross_sectional.ignorant import ignorant_filter
from noiseid_cli.estimators.cross_sectional.information import Evaluation
from noiseid_cli.estimators.cross_sectional.problem import CommonBias, Coordinates, CrossSection, Family, Theta
from noiseid_cli.estimators.cross_sectional.restoring import RestoredBias, restore_bias
from noiseid_cli.models.parametric import ParametricMatrices
from noiseid_cli.models.recording import Array, Recording


@dataclass(frozen=True)
class Carried:
    """c before the next test: mean (nc,), covariance (nc, nc), derivatives dmean (p, nc), dcovariance (p, nc, nc)."""

    mean: Array
    covariance: Array
    dmean: Array
    dcovariance: Array

    @classmethod
    def before_all(cls, common: CommonBias | None, p: int) -> Carried:
        """Before the first test; of size zero where nothing is shared."""
        first = np.zeros((0, 0)) if common is None else common.first
        nc = len(first)
        return cls(np.zeros(nc), first, np.zeros((p, nc)), np.zeros((p, nc, nc)))


def correlated(
    tests: CrossSection, theta: Theta, coordinates: Coordinates, carried: Carried | None = None
) -> tuple[Evaluation, Carried]:
    """Natural (mu, Sigma, alpha) evaluation of each test given those before it, and c after the last.

    Args:
        tests: in order; ``common`` is set.
        theta: values of the unknowns.
        coordinates: which entries of Sigma are free.
        carried: c before the first of them, if tests came before.

    Raises:
        ModelError: the tests share no bias.
        EstimationError: a filter fails.
    """
    common, na, p = tests.common, coordinates.na, coordinates.size
    if common is None:
        raise ModelError("these tests share no bias")
    carried = carried or Carried.before_all(common, p)
    order = np.concatenate((np.arange(na, p), np.arange(na)))
    results: list[RestoredBias] = []
    for i, (recording, T) in enumerate(zip(tests.recordings, tests.maps, strict=True)):
        run = ignorant_filter(tests.matrices(i, theta.alpha), [recording], T)
        after = restore_bias(run, *_before(theta, coordinates, carried))
        results.append(after)
        nb = coordinates.nb
        carried = Carried(
            after.mean[nb:].copy(),
            after.covariance[nb:, nb:] + common.walk,
            after.dmean[:, nb:].copy(),
            after.dcovariance[:, nb:, nb:].copy(),
        )
    evaluation = Evaluation(
        np.array([r.nll for r in results]),
        np.array([r.gradient[order] for r in results]),
        np.array([r.information[np.ix_(order, order)] for r in results]),
    )
    return evaluation, carried


def _before(theta: Theta, coordinates: Coordinates, carried: Carried) -> tuple[Array, Array, Array, Array]:
    """Law of (b, c) before a test, with its derivatives."""
    nb, na, p = coordinates.nb, coordinates.na, coordinates.size
    n = nb + len(carried.mean)
    D, dm, dD = np.zeros((n, n)), np.zeros((p, n)), np.zeros((p, n, n))
    D[:nb, :nb], D[nb:, nb:] = theta.Sigma, carried.covariance
    dm[:, nb:], dD[:, nb:, nb:] = carried.dmean, carried.dcovariance
    dm[na : na + nb, :nb] = np.eye(nb)
    for i, (r, c) in enumerate(zip(coordinates.rows, coordinates.columns, strict=True)):
        dD[na + nb + i, r, c] = dD[na + nb + i, c, r] = 1.0
    return np.concatenate((theta.mu, carried.mean)), D, dm, dD


def with_output_bias(family: Family, maps: tuple[Array, ...], E: Array) -> tuple[Family, tuple[Array, ...]]:
    """A bias of the outputs, y = C x + D u + E c + v, as constant extra states.

    Args:
        family: without the bias.
        maps: T_i (nx, nb).
        E: (ny, nc).

    Returns:
        The family and the maps with c as the last nc states and columns.
    """
    nc = E.shape[1]

    def biased(alpha: Array, recording: Recording) -> ParametricMatrices:
        m = family(alpha, recording)
        A, E_all = _padded(m.A, nc, nc), np.broadcast_to(E, (len(m.C), *E.shape))
        A[:, -nc:, -nc:] = np.eye(nc)
        return ParametricMatrices(
            A=A, B=_padded(m.B, nc, 0), Q=_padded(m.Q, nc, nc),
            C=np.concatenate((m.C, E_all), axis=2), D=m.D, R=m.R, S_a=_padded(m.S_a, nc, nc),
            dA=_padded(m.dA, nc, nc), dB=_padded(m.dB, nc, 0), dQ=_padded(m.dQ, nc, nc),
            dC=_padded(m.dC, 0, nc), dD=m.dD, dR=m.dR, dS_a=_padded(m.dS_a, nc, nc),
        )  # fmt: skip

    wide = []
    for T in maps:
        stacked = _padded(T, nc, nc)
        stacked[-nc:, -nc:] = np.eye(nc)
        wide.append(stacked)
    return biased, tuple(wide)


def _padded(M: Array, rows: int, columns: int) -> Array:
    """Zeros below and to the right of each matrix."""
    return np.pad(M, [(0, 0)] * (M.ndim - 2) + [(0, rows), (0, columns)])

"""Exact expected information of a linear Gaussian model in its noise values, and the Cramer-Rao bound from it.

The innovations at the truth are white with covariance S, so that the expectation over the data needs no simulation. For
unknowns a and b, with m the predicted mean and nu = y - H m - D u,

    I_ab = sum over k of  1/2 tr(S^-1 dS_a S^-1 dS_b) + E[dnu_a' S^-1 dnu_b]

(Caines, Linear Stochastic Systems, 1988, sec. 7.2; Cavanaugh & Shumway, Stat. Probab. Lett. 26, 1996). Of the noise
values dnu_a = -H dm_a, and the derivative of the mean is itself driven by the innovations,

    dm_filt_a = (I - K H) dm_a + dK_a nu,    dm_a next = F dm_filt_a,

so that the second moments C_ab = E[dm_a dm_b'] follow a recursion of their own. All is whitened by the factor of S.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.coordinates import Coordinates
from noiseid_cli.estimators.observed_information import Information
from noiseid_cli.estimators.quantities import figures
from noiseid_cli.estimators.unknowns import Unknowns
from noiseid_cli.filters.ekf import FilterDivergedError, Filtered, extended_kalman_filter
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording

# Jacobians of a linear model are equal along any two paths, but for rounding.
SAME = 1e-9


def expected_information(
    model: CompiledModel, recordings: Sequence[Recording], noise: NoiseValues, unknowns: Unknowns
) -> Information:
    """Expected information of the unknown noise values in the coordinates of ``Unknowns.pack``.

    Args:
        model: linear in states and noises, at the true values of its parameters, which count as known.
        recordings: the tests; of their outputs only which ones are missing counts.
        noise: the true noise values.
        unknowns: what is to be estimated of them.

    Raises:
        EstimationError: the model is not linear, or the true values do not have the structure of the unknowns.
        FilterDivergedError: the filter fails at the truth.
    """
    coordinates = Coordinates(unknowns, noise, model)
    z = _coordinates(unknowns, noise)
    dQ, dR, dP0, dm0 = _directions(unknowns, noise)
    total = np.zeros((z.size, z.size))
    for i, recording in enumerate(recordings):
        run = extended_kalman_filter(model, recording, noise, i)
        if not _is_linear(model, recording, noise, i, run):
            raise EstimationError(
                f"the expected information is exact for linear models only: the Jacobians of {model.name} move with "
                "its state"
            )
        total += _of_test(run, dQ, dR, dP0, dm0)
    return Information(coordinates.names, z, total, len(recordings))


def cramer_rao(
    model: CompiledModel, recordings: Sequence[Recording], noise: NoiseValues, unknowns: Unknowns
) -> dict[tuple[str, str], float]:
    """Least standard error of an unbiased estimate of each standard deviation, correlation and mean.

    Args:
        model, recordings, noise, unknowns: as in ``expected_information``.

    Returns:
        By metric and index, such as ``process_noise_std`` and ``vm1``; NaN where the data do not determine it.
    """
    covariance = expected_information(model, recordings, noise, unknowns).covariance()
    out = {}
    for figure in figures(model, unknowns, noise):
        moved = np.flatnonzero(figure.slope)
        slope = figure.slope[moved]
        out[figure.metric, figure.index] = float(np.sqrt(slope @ covariance[np.ix_(moved, moved)] @ slope))
    return out


def _coordinates(unknowns: Unknowns, noise: NoiseValues) -> Array:
    """(d,) coordinates of the truth, which must be where the structure can reach it."""
    for letter, structure, (value,) in unknowns.covariances(noise):
        reached = structure.covariance(structure.coordinates(value))
        size = np.sqrt(np.outer(np.diag(value), np.diag(value)))
        if np.any(np.abs(reached - value) > SAME * size):
            raise EstimationError(f"the true {letter} does not have the structure in which it is estimated")
    return unknowns.pack(noise)


def _directions(unknowns: Unknowns, noise: NoiseValues) -> tuple[Array, Array, Array, Array]:
    """(d, ., .) derivatives of Q, R and P0 and (d, nx) of m0 in each coordinate."""
    d, at = unknowns.pack(noise).size, 0
    found = {letter: np.zeros((d, *getattr(noise, letter).shape)) for letter in ("Q", "R", "P0")}
    for letter, structure, (value,) in unknowns.covariances(noise):
        slopes = structure.jacobian(structure.coordinates(value))
        found[letter][at : at + len(slopes)] = slopes
        at += len(slopes)
    dm0 = np.zeros((d, noise.m0.shape[1]))
    if unknowns.m0:
        dm0[at:] = np.diag(unknowns.mean_scale(noise))
    return found["Q"], found["R"], found["P0"], dm0


def _of_test(run: Filtered, dQ: Array, dR: Array, dP0: Array, dm0: Array) -> Array:
    """(d, d) expected information of one test."""
    from scipy.linalg import solve_triangular

    total = np.zeros((len(dQ), len(dQ)))
    dP, C = dP0.copy(), dm0[:, None, :, None] * dm0[None, :, None, :]
    for k, S in enumerate(run.S):
        seen = np.flatnonzero(~np.isnan(run.innovation[k]))
        if seen.size:
            L = np.linalg.cholesky(S[np.ix_(seen, seen)])
            H = solve_triangular(L, run.H[k][seen], lower=True)
            inverse = solve_triangular(L, np.eye(seen.size), lower=True)
            noise = inverse @ dR[:, seen[:, None], seen] @ inverse.T
            K = run.U_pred[k].T @ (run.U_pred[k] @ H.T)
            dS = H @ dP @ H.T + noise
            dK = dP @ H.T - K @ dS
            total += 0.5 * np.einsum("aij,bij->ab", dS, dS) + np.einsum("ij,abjk,ik->ab", H, C, H, optimize=True)
            J = np.eye(len(K)) - K @ H
            C = J @ C @ J.T + dK[:, None] @ dK[None].swapaxes(-1, -2)
            dP = J @ dP @ J.T + K @ noise @ K.T
        if k < len(run.F):
            F, G = run.F[k], run.G[k]
            C = F @ C @ F.T
            dP = F @ dP @ F.T + G @ dQ @ G.T
    return total


def _is_linear(model: CompiledModel, recording: Recording, noise: NoiseValues, test: int, run: Filtered) -> bool:
    """The Jacobians are the same along paths that begin far to both sides."""
    here = noise.m0[test]
    for sign in (-1.0, 1.0):
        moved = here + sign * (1.0 + np.abs(here)) * (1.0 + np.sqrt(np.arange(1.0, here.size + 1.0)))
        try:
            other = extended_kalman_filter(model, recording, replace(noise, m0=moved[None]))
        except FilterDivergedError:
            return False
        pairs = ((run.F, other.F), (run.G, other.G), (run.H, other.H))
        if not all(np.allclose(a, b, rtol=SAME, atol=0.0) for a, b in pairs):
            return False
    return True

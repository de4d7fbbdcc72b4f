"""Score and complete-data information of the unknown noise values, in free coordinates, from one pass of EM.

By Fisher's identity the score is the expected gradient of the complete-data log-likelihood. With M the second moment of
the noise given the data (EM's M-step without structure) and n the number of steps it is, for a covariance Q,

    dl/dQ = n/2 Q^-1 (M - Q) Q^-1,

and the complete-data information of Q in directions A and B is n/2 tr(Q^-1 A Q^-1 B) (Dempster, Laird & Rubin, JRSS B
39, 1977). The statistics are those of the filter's own linearisation: for a linear model the score is that of the
log-likelihood which the filter reports; for a nonlinear one it leaves out that the points of linearisation move.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from noiseid_cli.estimators.em_statistics import FILTERED, Statistics, e_step
from noiseid_cli.estimators.unknowns import Unknowns
from noiseid_cli.filters.sigma_points import SigmaWeights
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording


@dataclass(frozen=True)
class Score:
    """One pass at one point.

    Attributes:
        loglik: log-likelihood that the filter reports.
        gradient: (d,) score in the coordinates of ``Unknowns.pack``.
        complete: (d, d) information that the noise itself would hold, were it recorded.
    """

    loglik: float
    gradient: Array
    complete: Array


def score(
    model: CompiledModel,
    recordings: Sequence[Recording],
    noise: NoiseValues,
    unknowns: Unknowns,
    weights: SigmaWeights | None = None,
) -> Score:
    """Log-likelihood, score and complete-data information at one point.

    Args:
        model, recordings: the problem.
        noise: the point; unknown covariances must be positive definite.
        unknowns: what is unknown, which gives the coordinates.
        weights: of a sigma-point filter and smoother; without them the extended ones.

    Raises:
        FilterDivergedError: the filter fails at this point.
        LinAlgError: an unknown covariance is singular, or as good as that.
    """
    blocks = None if unknowns.R is None else unknowns.R.block_of
    return score_of(e_step(model, recordings, noise, FILTERED, blocks, weights), noise, unknowns)


def score_of(statistics: Statistics, noise: NoiseValues, unknowns: Unknowns) -> Score:
    """The same from a pass that was made at ``noise``, with whatever linearisation.

    Its zeros are the fixed points of EM with the same statistics.

    Raises:
        LinAlgError: an unknown covariance is singular, or as good as that.
    """
    gradients, informations = [], []
    for name, structure, (value,) in unknowns.covariances(noise):
        counts, moment = _moment(name, statistics, noise)
        if not structure.scale:
            moment = np.where(structure.block_of[:, None] == structure.block_of[None, :], moment, 0.0)
        # In units of the standard deviations, where nothing overflows before its time.
        scale = np.sqrt(np.diag(value))
        units = np.outer(scale, scale)
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # looked at below
            inverse = np.linalg.inv(value / units)
            excess = (np.where(np.isfinite(moment), moment, value) - value) / units
            directions = structure.jacobian(structure.coordinates(value)) / units
        if not all(np.all(np.isfinite(part)) for part in (inverse, excess, directions)):
            raise np.linalg.LinAlgError(f"{name} is so small that its inverse is beyond the floating-point numbers")
        slope = 0.5 * counts[:, None] * (inverse @ excess @ inverse)
        turned = inverse @ directions
        gradients.append(np.einsum("ij,aij->a", slope, directions))
        left, right = counts[:, None] * turned, turned.transpose(0, 2, 1)
        informations.append(0.5 * left.reshape(len(turned), -1) @ right.reshape(len(turned), -1).T)
    if unknowns.m0:
        g, information = _mean_score(statistics, noise, unknowns.mean_scale(noise))
        gradients.append(g)
        informations.append(information)
    return Score(statistics.loglik, np.concatenate(gradients), _block_diagonal(informations))


def _moment(name: str, statistics: Statistics, noise: NoiseValues) -> tuple[Array, Array]:
    """(p,) number of noises that each row stands for, and (p, p) their mean second moment given the data."""
    if name == "Q":
        return np.full(len(noise.Q), float(statistics.steps)), statistics.moment_v
    if name == "R":
        return statistics.samples, statistics.moment_e
    d = statistics.m_first - noise.m0
    second = statistics.U_first.transpose(0, 2, 1) @ statistics.U_first + d[:, :, None] * d[:, None, :]
    return np.full(len(noise.P0), float(len(d))), second.mean(axis=0)


def _mean_score(statistics: Statistics, noise: NoiseValues, scale: Array) -> tuple[Array, Array]:
    """Score and complete-data information of the common initial mean, in units of ``scale``.

    A component that is exactly known beforehand (no variance in P0) has neither.
    """
    free = np.diag(noise.P0) > 0.0
    weight = np.zeros_like(noise.P0)
    s = scale[free]
    weight[np.ix_(free, free)] = np.linalg.inv(noise.P0[np.ix_(free, free)] / np.outer(s, s))
    total = (statistics.m_first - noise.m0).sum(axis=0) / scale
    return weight @ total, len(noise.m0) * weight


def _block_diagonal(parts: Sequence[Array]) -> Array:
    size = sum(len(part) for part in parts)
    out, at = np.zeros((size, size)), 0
    for part in parts:
        out[at : at + len(part), at : at + len(part)] = part
        at += len(part)
    return out

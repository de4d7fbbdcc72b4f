"""Likelihood, gradient and information of many tests from their statistics, in information form.

No inverse of J or of Sigma is taken: tests too short to determine b count like any other, and Sigma = 0 is allowed.
Where J is regular this is porter1983_partitioned_recursive, eq. (34) to (38), with W = (Sigma + P)^-1, P = J^-1. The
cross blocks are exact also where the map from x_0 to y depends on alpha; the paper's (39), (40) are their special case.
Only the alpha-alpha block is sampled (30): the information of one very short test need not be positive semidefinite,
that of many is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from noiseid_cli.estimators.cross_sectional.ignorant import Statistics
from noiseid_cli.estimators.cross_sectional.problem import Coordinates
from noiseid_cli.models.recording import Array


@dataclass(frozen=True)
class Evaluation:
    """What tests say at one theta.

    Attributes:
        nll: (tests,) the paper's l, the negative log-likelihood less its n m/2 log 2 pi term.
        gradient: (tests, p) of nll; information: (tests, p, p) its expected second derivative.
    """

    nll: Array
    gradient: Array
    information: Array


@dataclass(frozen=True)
class Restored:
    """What statistics (J, j) say about b of each test at given mu, Sigma.

    Attributes:
        M: (., nb, nb) (I + Sigma J)^-1; W: (., nb, nb) J M = (Sigma + P)^-1.
        u: (., nb) M' (j - J mu) = (Sigma + P)^-1 (b^ - mu).
        covariance, mean: (., nb, nb), (., nb) of b given the test.
        nll: (.,) the part of l that depends on b.
    """

    M: Array
    W: Array
    u: Array
    covariance: Array
    mean: Array
    nll: Array


def restore(J: Array, j: Array, mu: Array, Sigma: Array) -> Restored:
    """Bring mu and Sigma back into the statistics of tests; J (tests, nb, nb), j (tests, nb)."""
    grown = np.eye(len(mu)) + Sigma @ J
    M = np.asarray(np.linalg.inv(grown), dtype=np.float64)
    s = j - J @ mu
    u = np.einsum("tmn,tm->tn", M, s)
    W, covariance = _symmetric(J @ M), _symmetric(M @ Sigma)
    pull = np.einsum("tmn,tn->tm", covariance, s)
    # 2 l = log det(I + Sigma J) + mu' J mu - 2 mu' j - s' Pb s
    nll: Array = 0.5 * (np.linalg.slogdet(grown)[1] - (j + s) @ mu - np.einsum("tm,tm->t", s, pull))
    return Restored(M, W, u, covariance, mu + pull, nll)


def beta_blocks(b: Restored, coordinates: Coordinates) -> tuple[Array, Array]:
    """Gradient (tests, n_beta) and information (tests, n_beta, n_beta) in mu and Sigma."""
    nb, n_beta = coordinates.nb, coordinates.n_beta
    m, n = coordinates.rows, coordinates.columns
    C = _multiplicity(coordinates)
    gradient = np.hstack((-b.u, C * (b.W[:, m, n] - b.u[:, m] * b.u[:, n])))
    information = np.zeros((len(b.u), n_beta, n_beta))
    information[:, :nb, :nb] = b.W  # (36); (37) is zero
    left, right = np.array(m)[:, None], np.array(n)[:, None]
    products = b.W[:, left, m] * b.W[:, right, n] + b.W[:, left, n] * b.W[:, right, m]
    information[:, nb:, nb:] = np.outer(C, C) * products  # (38)
    return gradient, information


def evaluate_statistics(
    s: Statistics, mu: Array, Sigma: Array, coordinates: Coordinates, alpha_information: Array
) -> Evaluation:
    """Everything about the tests of ``s`` (stacked) in natural (mu, Sigma, alpha).

    Args:
        s: statistics at alpha.
        mu, Sigma: law of b.
        coordinates: which entries of Sigma are free.
        alpha_information: (tests, na, na) the alpha-alpha blocks.
    """
    n_beta, p = coordinates.n_beta, coordinates.size
    J, j, c = s.gram[:, 1:, 1:], s.gram[:, 1:, 0], s.gram[:, 0, 0] + s.logdet
    dJ, dj, dc = s.dgram[..., 1:, 1:], s.dgram[..., 1:, 0], s.dgram[..., 0, 0] + s.dlogdet
    b = restore(J, j, mu, Sigma)
    gradient, information = np.empty((len(J), p)), np.empty((len(J), p, p))
    gradient[:, :n_beta], information[:, :n_beta, :n_beta] = beta_blocks(b, coordinates)
    # Fisher's identity: the derivative of the ignorant filter's terms, averaged over b given the test.
    moment = b.covariance + b.mean[:, :, None] * b.mean[:, None, :]
    gradient[:, n_beta:] = 0.5 * (
        dc - 2.0 * np.einsum("tam,tm->ta", dj, b.mean) + np.einsum("tamn,tmn->ta", dJ, moment)
    )
    Mt = b.M.transpose(0, 2, 1)
    dW = np.einsum("tmi,taij,tjn->tamn", Mt, dJ, b.M)
    x = np.einsum("tacn,c->tan", s.cross, np.concatenate(([1.0], mu)))
    V = np.einsum("tamj,tjn->tamn", s.cross[:, :, 1:, :], b.M)
    with_mu = np.einsum("tmj,taj->tam", Mt, x)  # replaces (39)
    with_Sigma = (V + V.transpose(0, 1, 3, 2) - dW)[:, :, coordinates.rows, coordinates.columns]  # replaces (40)
    cross = np.concatenate((with_mu, _multiplicity(coordinates) * with_Sigma), axis=2)
    information[:, n_beta:, :n_beta] = cross
    information[:, :n_beta, n_beta:] = cross.transpose(0, 2, 1)
    information[:, n_beta:, n_beta:] = alpha_information
    return Evaluation(b.nll + 0.5 * c, gradient, information)


def _multiplicity(coordinates: Coordinates) -> Array:
    """C_mn: 1/2 on the diagonal of Sigma, 1 off it."""
    return np.where(np.equal(coordinates.rows, coordinates.columns), 0.5, 1.0)


def _symmetric(A: Array) -> Array:
    return 0.5 * (A + A.transpose(0, 2, 1))

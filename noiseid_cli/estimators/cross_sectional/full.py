"""The standard filter differentiated in all of theta: the method that the partitioned one replaces, and its twin.

porter1983_partitioned_recursive, eq. (26), (29), (30).
"""

from __future__ import annotations

import numpy as np

from noiseid_cli.estimators.cross_sectional.ignorant import run_filter
from noiseid_cli.estimators.cross_sectional.problem import Coordinates, Theta
from noiseid_cli.estimators.cross_sectional.restoring import expected_information, likelihood
from noiseid_cli.models.parametric import ParametricMatrices
from noiseid_cli.models.recording import Array, Recording


def full_evaluation(
    m: ParametricMatrices, recording: Recording, T: Array, theta: Theta, coordinates: Coordinates
) -> tuple[float, Array, Array]:
    """Likelihood of one test with gradient and information in natural (mu, Sigma, alpha).

    Returns:
        l (26), the negative log-likelihood less its n m/2 log 2 pi term; gradient (29), (p,); information (30), (p, p).
    """
    nx, nb = T.shape
    na, p = coordinates.na, coordinates.size
    # The filter counts alpha first: only those parameters enter the matrices.
    dX, dP = np.zeros((p, nx, 1)), np.zeros((p, nx, nx))
    dP[:na] = m.dS_a
    dX[na : na + nb, :, 0] = T.T
    for i, (r, c) in enumerate(zip(coordinates.rows, coordinates.columns, strict=True)):
        outer = np.outer(T[:, r], T[:, c])
        dP[na + nb + i] = outer if r == c else outer + outer.T
    empty = np.empty((nx, 0))
    run = run_filter(
        m,
        [recording],
        m.S_a + T @ theta.Sigma @ T.T,
        dP,
        (T @ theta.mu)[:, None].copy(),
        dX,
        empty,
        np.empty((na, nx, 0)),
    )
    nll, gradient = likelihood(run.logdet, run.G, run.dG, run.dS)
    information = expected_information(run.dG, run.dS)[0]
    order = np.concatenate((np.arange(na, p), np.arange(na)))
    return nll, gradient[order], information[np.ix_(order, order)]

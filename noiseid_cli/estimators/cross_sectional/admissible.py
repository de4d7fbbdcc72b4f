"""The closed set Sigma >= 0: projection onto it, and the directions that are free at its boundary.

Eigenvalues are taken after each component of b is divided by the reported standard deviation of its mean, so that a
change of units changes nothing; the projection is the Frobenius one in these units.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from noiseid_cli.estimators.cross_sectional.problem import Coordinates, Theta
from noiseid_cli.models.recording import Array

# A scaled eigenvalue below this is zero (1 is the square of the reported standard deviation of a mean).
ZERO = 1e-12


def project(theta: Theta, information: Array, coordinates: Coordinates) -> Theta:
    """The same theta where Sigma >= 0, else with the negative part of Sigma removed."""
    if coordinates.structure == "diagonal":
        variances = np.diag(theta.Sigma)
        return theta if np.all(variances >= 0.0) else replace(theta, Sigma=np.diag(np.maximum(variances, 0.0)))
    scale = _scale(information, coordinates)
    values, vectors = np.linalg.eigh(theta.Sigma / np.outer(scale, scale))
    if values[0] >= -ZERO:
        return theta
    Sigma = (vectors * np.maximum(values, 0.0)) @ vectors.T * np.outer(scale, scale)
    return replace(theta, Sigma=0.5 * (Sigma + Sigma.T))


def free_directions(theta: Theta, gradient: Array, information: Array, coordinates: Coordinates) -> Array:
    """(p, free) basis of the directions to move in: all but null directions of Sigma that l wants negative.

    At a Sigma with null space N, held are the directions n n' with n'(dl/dSigma) n > 0, n in N; motions of the null
    space itself (N K' + K N') stay free.
    """
    nb, n_beta = coordinates.nb, coordinates.n_beta
    slope = np.zeros((nb, nb))
    slope[coordinates.rows, coordinates.columns] = gradient[nb:n_beta]
    slope = 0.5 * (slope + slope.T)  # so that dl = sum slope o dSigma
    scale = _scale(information, coordinates)
    slope *= np.outer(scale, scale)
    basis = np.eye(coordinates.size)
    if coordinates.structure == "diagonal":
        held = (np.diag(theta.Sigma) <= ZERO * scale**2) & (np.diag(slope) > 0.0)
        return basis[:, ~np.concatenate((np.zeros(nb, bool), held, np.zeros(coordinates.na, bool)))]
    values, vectors = np.linalg.eigh(theta.Sigma / np.outer(scale, scale))
    null = vectors[:, values <= ZERO]
    outward, turn = np.linalg.eigh(null.T @ slope @ null)
    held_vectors = (null @ turn)[:, outward > 0.0]
    if held_vectors.shape[1] == 0:
        return basis
    # Held products n n'^T as functionals on dSigma (scaled); free directions are their null space.
    functionals = []
    for a in range(held_vectors.shape[1]):
        for b in range(a, held_vectors.shape[1]):
            outer = np.outer(held_vectors[:, a], held_vectors[:, b]) / np.outer(scale, scale)
            outer = outer + outer.T
            outer[np.diag_indices(nb)] *= 0.5
            functionals.append(outer[coordinates.rows, coordinates.columns])
    entries = np.outer(scale, scale)[coordinates.rows, coordinates.columns]
    _, _, V = np.linalg.svd(np.array(functionals) * entries)
    kept = V[len(functionals) :].T * entries[:, None]
    free = np.zeros((coordinates.size, coordinates.size - len(functionals)))
    free[:nb, :nb] = np.eye(nb)
    free[nb:n_beta, nb : nb + kept.shape[1]] = kept
    free[n_beta:, nb + kept.shape[1] :] = np.eye(coordinates.na)
    return free


def boundary(theta: Theta, information: Array, coordinates: Coordinates) -> bool:
    """Whether Sigma is singular."""
    scale = _scale(information, coordinates)
    return bool(np.linalg.eigvalsh(theta.Sigma / np.outer(scale, scale))[0] <= ZERO)


def _scale(information: Array, coordinates: Coordinates) -> Array:
    """Unit of each component of b: the standard deviation that the information gives its mean."""
    own = np.diag(information)[: coordinates.nb]
    return np.where(own > 0.0, 1.0 / np.sqrt(np.where(own > 0.0, own, 1.0)), 1.0)

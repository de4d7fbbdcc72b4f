"""Fisher scoring over (mu, Sigma >= 0, alpha) with step halving.

Sigma >= 0 is a closed set, and zero is a legitimate estimate. A direction in which Sigma is zero and the likelihood
would have it negative is held there (active set); a step that leaves the set is projected onto it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from noiseid_cli.errors import EstimationError, ModelError
from noiseid_cli.estimators.cross_sectional.admissible import free_directions, project
from noiseid_cli.estimators.cross_sectional.problem import Coordinates, Theta
from noiseid_cli.models.recording import Array

Objective = Callable[[Theta], tuple[float, Array, Array]]
"""The paper's l, its gradient (p,) and information (p, p) in the coordinates."""

MAX_HALVINGS = 40
# No step changes the logarithm of an alpha by more: far out, its exponential and the filter overflow.
LONGEST = 5.0
# A rise of l below this share of it is rounding of its sum, not a rise.
ROUNDING = 1e-12


@dataclass(frozen=True)
class Scored:
    """The end of a scoring run.

    Attributes:
        theta: values; nll, gradient, information: the objective there, in the coordinates.
        decrement: g' H^-1 g on the free directions.
        converged: the decrement is below the tolerance.
        halvings: how often a step was halved.
        held: number of directions of Sigma that are held at zero.
        path: (iterations + 1, p) accepted points; path_nll: (iterations + 1,) l there.
        reason: how it ended, in a sentence.
    """

    theta: Theta
    nll: float
    gradient: Array
    information: Array
    decrement: float
    converged: bool
    halvings: int
    held: int
    path: Array
    path_nll: Array
    reason: str


def score(
    objective: Objective, start: Theta, coordinates: Coordinates, tolerance: float = 1e-10, max_iterations: int = 100
) -> Scored:
    """Minimise l from ``start`` (Sigma >= 0) until the Newton decrement is below ``tolerance``.

    Raises:
        EstimationError: the objective fails at the start, the information is not positive definite on the way, or the
            likelihood leaves the range of floating-point numbers.
    """
    theta, halvings = start, 0
    nll, gradient, information = objective(theta)
    path, path_nll = [coordinates.pack(theta)], [nll]
    while True:
        free = free_directions(theta, gradient, information, coordinates)
        with np.errstate(over="ignore", invalid="ignore"):  # told of below
            step = -free @ solve_positive(free.T @ information @ free, free.T @ gradient)
            decrement = float(-gradient @ step)
        if not np.isfinite(decrement):
            raise EstimationError(
                f"the Newton decrement of the likelihood is {decrement:g} after {len(path) - 1} iterations: the tests "
                "and the start are too far apart for its numbers; bring the start to their scale"
            )
        converged, reason = decrement < tolerance, "the likelihood is at its maximum"
        if not converged and len(path) > max_iterations:
            reason = "more iterations are needed"
        elif not converged:
            found = _line_search(objective, theta, nll, step, information, coordinates)
            if found is not None:
                theta, (nll, gradient, information), halved = found
                halvings += halved
                path.append(coordinates.pack(theta))
                path_nll.append(nll)
                continue
            reason = "no step along the scoring direction raises the likelihood"
        reason += f" (Newton decrement {decrement:.2g} after {len(path) - 1} iterations)"
        held = coordinates.size - free.shape[1]
        return Scored(
            theta,
            nll,
            gradient,
            information,
            decrement,
            converged,
            halvings,
            held,
            np.array(path),
            np.array(path_nll),
            reason,
        )


def _line_search(
    objective: Objective, theta: Theta, nll: float, step: Array, information: Array, coordinates: Coordinates
) -> tuple[Theta, tuple[float, Array, Array], int] | None:
    """Halve the step until l does not rise; None if it never stops rising."""
    origin = coordinates.pack(theta)
    for halved in range(MAX_HALVINGS):
        part = 0.5**halved * step
        if coordinates.log_alpha and np.any(np.abs(part[coordinates.n_beta :]) > LONGEST):
            continue
        candidate = project(coordinates.unpack(origin + part), information, coordinates)
        try:
            value = objective(candidate)
        except (EstimationError, ModelError):
            continue  # The filter fails there, or the model does not allow such alpha: too long a step.
        if value[0] <= nll + ROUNDING * abs(nll):
            return candidate, value, halved
    return None


def solve_positive(H: Array, g: Array) -> Array:
    """H^-1 g for a positive definite H, whatever the units.

    Raises:
        EstimationError: H is not positive definite.
    """
    scale = np.sqrt(np.abs(np.diag(H)))
    try:
        if not np.all(np.isfinite(scale)) or np.any(scale == 0.0):
            raise np.linalg.LinAlgError
        L = np.linalg.cholesky(H / np.outer(scale, scale))
    except np.linalg.LinAlgError as error:
        raise EstimationError(
            "the information matrix is not positive definite: at the values reached, these tests do not determine all "
            "unknowns; take more or longer tests, a diagonal Sigma, or a start nearer to the truth"
        ) from error
    right = (g.T / scale).T
    solution: Array = (np.linalg.solve(L.T, np.linalg.solve(L, right)).T / scale).T
    return solution

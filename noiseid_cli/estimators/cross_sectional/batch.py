"""Batch maximum likelihood over a cross-section of tests (porter1983_partitioned_recursive, section 3).

Scoring with the expected information, over all tests at once, to the end; standard errors from its inverse.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from noiseid_cli.estimators.cross_sectional.evaluate import Evaluator, evaluate
from noiseid_cli.estimators.cross_sectional.problem import Coordinates, CrossSection, Theta
from noiseid_cli.estimators.cross_sectional.scoring import Scored, score, solve_positive
from noiseid_cli.models.recording import Array


@dataclass(frozen=True)
class BatchOptions:
    """Options of ``batch_ml``.

    Attributes:
        evaluator: ``partitioned`` (the paper's) or ``full`` (differentiated standard filter; same likelihood).
        tolerance: stop when the Newton decrement g' H^-1 g is below it.
        max_iterations: give up after so many.
    """

    evaluator: Evaluator = "partitioned"
    tolerance: float = 1e-10
    max_iterations: int = 100


@dataclass(frozen=True)
class BatchEstimate:
    """The end of a batch run.

    Attributes:
        theta: estimate; start: where it began; coordinates: the meaning of vectors and matrices here.
        scored: iterations, decrement, halvings, held directions, path and reason, in the coordinates.
        covariance: (p, p) inverse information in natural (mu, Sigma, alpha); held directions count as free.
        seconds: wall-clock time.
    """

    theta: Theta
    start: Theta
    coordinates: Coordinates
    scored: Scored
    covariance: Array
    seconds: float

    @property
    def converged(self) -> bool:
        """The stop rule was met."""
        return self.scored.converged

    @property
    def standard_errors(self) -> Array:
        """(p,) of mu, the free entries of Sigma, alpha, in their own units."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


def batch_ml(
    tests: CrossSection,
    start: Theta,
    coordinates: Coordinates,
    options: BatchOptions | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> BatchEstimate:
    """Estimate theta from all tests.

    Args:
        tests: the cross-section.
        start: values to start from; Sigma >= 0.
        coordinates: which entries of Sigma are free, and whether alpha is positive.
        options: see ``BatchOptions``.
        progress: called after each evaluation with its number and the log-likelihood less its -m/2 log 2 pi term.

    Raises:
        EstimationError: the start does not fit, the filter fails there, or the tests do not determine all unknowns.
    """
    options = options or BatchOptions()
    coordinates.check(start)
    began, visits = time.perf_counter(), 0

    def objective(theta: Theta) -> tuple[float, Array, Array]:
        nonlocal visits
        e = evaluate(tests, theta, coordinates, options.evaluator)
        visits += 1
        nll = float(e.nll.sum())
        if progress is not None:
            progress(visits, -nll)
        return nll, e.gradient.sum(axis=0), e.information.sum(axis=0)

    scored = score(objective, start, coordinates, options.tolerance, options.max_iterations)
    slopes = coordinates.slopes(scored.theta)
    covariance = solve_positive(scored.information, np.eye(coordinates.size)) * np.outer(slopes, slopes)
    return BatchEstimate(scored.theta, start, coordinates, scored, covariance, time.perf_counter() - began)

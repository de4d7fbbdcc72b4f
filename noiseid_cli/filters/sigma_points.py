"""Sigma points: 2n + 1 points that carry a mean and a covariance through a nonlinear function.

Points x, x + eta U[i], x - eta U[i], i = 1..n, with P = U'U: rows of the upper factor are the deviations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.models.jit import routine


@dataclass(frozen=True)
class SigmaWeights:
    """Spread and weights of the 2n + 1 points of an n-vector.

    Attributes:
        eta: distance of the outer points in units of the rows of the factor.
        mean0: weight of the central point in means.
        cov0: weight of the central point in covariances; negative for small alpha.
        outer: weight of each outer point in both, 1 / (2 eta^2).
    """

    eta: float
    mean0: float
    cov0: float
    outer: float


def unscented(n: int, alpha: float = 1e-3, beta: float = 2.0, kappa: float | None = None) -> SigmaWeights:
    """Weights of the scaled unscented transformation (riva2017_sensitivity_asrukf, eq. 8; Wan & van der Merwe 2000).

    Args:
        n: length of the vector.
        alpha: spread of the points, above 0.
        beta: knowledge of the distribution; 2 for a normal one.
        kappa: second spread, above -n; default 3 - n.

    Raises:
        EstimationError: alpha or n + kappa is not above zero.
    """
    kappa = 3.0 - n if kappa is None else kappa
    if not (alpha > 0.0 and math.isfinite(alpha)):
        raise EstimationError(f"alpha, the spread of the sigma points, is {alpha:g}; it must be above 0")
    if not (n + kappa > 0.0 and math.isfinite(kappa)):
        raise EstimationError(f"kappa is {kappa:g}; with {n} states it must be above {-n}")
    c = alpha**2 * (n + kappa)  # n + lambda_f
    mean0 = (c - n) / c
    return SigmaWeights(math.sqrt(c), mean0, mean0 + 1.0 - alpha**2 + beta, 0.5 / c)


def cubature(n: int) -> SigmaWeights:
    """Weights of the third-degree spherical-radial cubature rule (Arasaratnam & Haykin 2009, eq. 37): no centre."""
    return SigmaWeights(math.sqrt(n), 0.0, 0.0, 0.5 / n)


@routine
def draw(x, U, eta, X):  # type: ignore[no-untyped-def]
    """Sigma points of mean x (n,) and upper factor U (n, n), written to X (2n + 1, n), the central one first."""
    n, one = np.uint64(x.shape[0]), np.uint64(1)
    for c in range(n):
        X[0, c] = x[c]
    for r in range(n):
        for c in range(n):
            d = eta * U[r, c] if r <= c else 0.0
            X[one + r, c] = x[c] + d
            X[one + n + r, c] = x[c] - d


@routine
def weighted_mean(X, outer, out):  # type: ignore[no-untyped-def]
    """Mean of the points X (2n + 1, m), written to out (m,); the central weight is 1 - 2n outer."""
    one, points = np.uint64(1), np.uint64(X.shape[0])
    for c in range(np.uint64(X.shape[1])):
        total = 0.0
        for r in range(one, points):
            total += X[r, c] - X[0, c]
        # The weights add up to 1: summing differences keeps digits where mean0 is large and negative.
        out[c] = X[0, c] + outer * total

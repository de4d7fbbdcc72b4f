"""Covariances of sigma points as sums of squares: no weight is negative and nothing is downdated.

The points come in pairs m +/- eta U[i]. Split the values f of a function into their odd and even parts,
o_i = (f+ - f-) / 2 and e_i = (f+ + f-) / 2 - f_0, and let d = 2 w sum e_i be the shift of the mean. The weighted
covariance of the unscented transformation, whose central weight may be large and negative, is identically

    P = 2 w sum o_i o_i' + 2 w sum (e_i - c d)(e_i - c d)',   c = (1 - sqrt(1 + W (w0c - w0m - 1))) / W,  W = 2 n w,

which expands to it because sum 2 w = W. The root is real wherever the weights give no negative variance: always for
kappa >= 0 and beta >= 0, and for the cubature rule (c = 1). The same holds for covariances between functions, so rows
of several functions may stand side by side.
"""

from __future__ import annotations

import math

from noiseid_cli.errors import EstimationError
from noiseid_cli.filters.sigma_points import SigmaWeights
from noiseid_cli.models.jit import routine


def pair_centre(weights: SigmaWeights, n: int) -> float:
    """The number c above.

    Args:
        weights: spread and weights of the 2n + 1 points.
        n: length of the vector that the points carry.

    Raises:
        EstimationError: the weights can give a negative variance.
    """
    W = 2.0 * n * weights.outer
    square = 1.0 + W * (weights.cov0 - weights.mean0 - 1.0)
    # The cubature rule has exactly zero here.
    if square < -8.0 * n * 2.2e-16:
        raise EstimationError(
            f"these sigma points can give a negative variance: with {n} states and this kappa, beta - alpha^2 is "
            f"{weights.cov0 - weights.mean0 - 1.0:.3g} and must be {-1.0 / W:.3g} at least"
        )
    return (1.0 - math.sqrt(max(square, 0.0))) / W


@routine
def split(values, eta, centre, mean, rows):  # type: ignore[no-untyped-def]
    """Mean and factor rows of the values of a function at the sigma points.

    Args:
        values: (2n + 1, m), the central point first, then the n plus and the n minus points.
        eta: spread of the points, with outer weight w = 1 / (2 eta^2).
        centre: c of the module's text.
        mean: (m,), written.
        rows: (>= 2n, m), written: sqrt(2 w) o_i, then sqrt(2 w) (e_i - c d); rows' rows is the covariance.

    Returns:
        Whether any row is not zero.
    """
    n = (values.shape[0] - 1) // 2
    varies = False
    for j in range(values.shape[1]):
        base = values[0, j]
        shift = 0.0
        for i in range(1, n + 1):
            even = 0.5 * ((values[i, j] - base) + (values[n + i, j] - base))
            rows[i - 1, j] = 0.5 * (values[i, j] - values[n + i, j]) / eta
            rows[n + i - 1, j] = even
            shift += even / (eta * eta)
            varies = varies or even != 0.0 or rows[i - 1, j] != 0.0
        mean[j] = base + shift
        for i in range(n, 2 * n):
            rows[i, j] = (rows[i, j] - centre * shift) / eta
    return varies

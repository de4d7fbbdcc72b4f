"""Climbing on from a tooth of a jagged likelihood, by EM.

The log-likelihood of an extended Kalman filter can be jagged: sharp friction moves the points of linearisation by
jumps. A climb by slopes then ends on a tooth, where its own curvature calls it converged. EM looks over the teeth,
because its step is as long as the noise itself allows: where a few steps of EM gain, the end was a tooth.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators import em
from noiseid_cli.estimators.coordinates import Coordinates
from noiseid_cli.estimators.estimate import Estimate
from noiseid_cli.filters.ekf import FilterDivergedError
from noiseid_cli.models.recording import Array, Recording

# Passes of the first look, and of EM where that gains; on a smooth top EM is at rest after two.
LOOK, PASSES = 8, 100


def lifted(
    coordinates: Coordinates, recordings: Sequence[Recording], z: Array, loglik: float, least: float
) -> tuple[Array | None, int]:
    """A point that EM reaches from an end, if it is higher by more than ``least``.

    Args:
        coordinates: of the problem, with unknown noise.
        recordings: the tests.
        z: (d,) the end of a climb; loglik: log-likelihood there.
        least: gain below which the end is taken for the top.

    Returns:
        The higher point, or None; and the number of passes over the data that it took.
    """
    passes = 0
    noise, model = coordinates.unpack(z)
    found: Estimate | None = None
    for budget in (LOOK, PASSES):
        options = em.EmOptions(linearisation="filtered", max_passes=budget)
        try:
            found = em.estimate(model, recordings, noise, coordinates.unknowns, options)
        except (EstimationError, FilterDivergedError, np.linalg.LinAlgError):
            return None, passes
        passes += found.passes
        if found.loglik <= loglik + least:
            return None, passes
        noise = found.final
    assert found is not None
    return coordinates.pack(found.final, coordinates.values(z)[0]), passes

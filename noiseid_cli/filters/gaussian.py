"""The Gaussian filter that an estimate is of: the extended one, or one with sigma points."""

from __future__ import annotations

from noiseid_cli.filters.ekf import Filtered, extended_kalman_filter
from noiseid_cli.filters.sigma_filter import SigmaFiltered, sigma_point_filter
from noiseid_cli.filters.sigma_points import SigmaWeights
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording


def gaussian_filter(
    model: CompiledModel,
    recording: Recording,
    noise: NoiseValues,
    test: int = 0,
    weights: SigmaWeights | None = None,
) -> Filtered | SigmaFiltered:
    """Filter one test.

    Args:
        model, recording, noise, test: as in ``ekf.extended_kalman_filter``.
        weights: of the sigma points; None runs the extended filter.

    Raises:
        FilterDivergedError: with the sample where it happened.
    """
    if weights is None:
        return extended_kalman_filter(model, recording, noise, test)
    return sigma_point_filter(model, recording, noise, weights, test)

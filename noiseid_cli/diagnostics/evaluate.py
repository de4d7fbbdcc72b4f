"""Run the filter over a dataset with given noise values, and measure how well the two agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from noiseid_cli.diagnostics.consistency import consistency
from noiseid_cli.diagnostics.evaluation import Evaluation
from noiseid_cli.filters.gaussian import gaussian_filter
from noiseid_cli.filters.path_error import path_error
from noiseid_cli.filters.sigma_points import SigmaWeights
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording


def evaluate(
    model: CompiledModel,
    recordings: Sequence[Recording],
    noise: NoiseValues,
    label: str,
    filter_name: str = "extended",
    weights: SigmaWeights | None = None,
) -> Evaluation:
    """Consistency of a Kalman filter with the data, and its path error where the truth is known.

    Args:
        model, recordings, noise: the problem; row i of ``noise.m0`` belongs to test i.
        label: ``start``, ``estimate`` or ``truth``.
        filter_name: ``extended``, ``unscented`` or ``cubature``; kept in the result.
        weights: sigma points of that filter; None for the extended one.

    Raises:
        FilterDivergedError: with test and sample.
    """
    filtered = [gaussian_filter(model, recording, noise, i, weights) for i, recording in enumerate(recordings)]
    errors = None
    if model.performance is not None and all(r.z_true is not None for r in recordings):
        errors = [path_error(model, r, f.m_filt) for r, f in zip(recordings, filtered, strict=True)]
    loglik = sum(f.loglik for f in filtered)
    found = consistency(label, [f.innovation for f in filtered], [f.S for f in filtered], loglik, errors)
    return replace(found, filter=filter_name)

"""Run the filter over a dataset with given noise values, and measure how well the two agree."""

from __future__ import annotations

from collections.abc import Sequence

from noiseid_cli.diagnostics.consistency import consistency
from noiseid_cli.diagnostics.evaluation import Evaluation
from noiseid_cli.filters.ekf import extended_kalman_filter
from noiseid_cli.filters.path_error import path_error
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording


def evaluate(model: CompiledModel, recordings: Sequence[Recording], noise: NoiseValues, label: str) -> Evaluation:
    """Consistency of the extended Kalman filter with the data, and its path error where the truth is known.

    Args:
        model, recordings, noise: the problem; row i of ``noise.m0`` belongs to test i.
        label: ``start``, ``estimate`` or ``truth``.

    Raises:
        FilterDivergedError: with test and sample.
    """
    filtered = [extended_kalman_filter(model, recording, noise, i) for i, recording in enumerate(recordings)]
    errors = None
    if model.performance is not None and all(r.z_true is not None for r in recordings):
        errors = [path_error(model, r, f.m_filt) for r, f in zip(recordings, filtered, strict=True)]
    loglik = sum(f.loglik for f in filtered)
    return consistency(label, [f.innovation for f in filtered], [f.S for f in filtered], loglik, errors)

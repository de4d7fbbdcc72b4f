"""Run the filter over a dataset with given noise values, and measure how well the two agree."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from noiseid_cli.diagnostics.consistency import consistency
from noiseid_cli.diagnostics.evaluation import Evaluation
from noiseid_cli.filters.ekf import extended_kalman_filter
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording


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


def path_error(model: CompiledModel, recording: Recording, m: Array) -> Array:
    """(N,) distance between the true performance output and that of the estimated states.

    For a tool position this is e_k of axelsson2011_poster, step V: sqrt(|x - x^|^2 + |y - y^|^2).

    Args:
        model: a model with a performance output.
        recording: a test whose true one is known.
        m: (N, nx) estimated states.
    """
    assert model.performance is not None
    assert recording.z_true is not None
    z = np.empty((recording.samples, model.nz))
    for k in range(recording.samples):
        model.performance(m[k], recording.u[k], model.parameters, z[k])
    return np.asarray(np.linalg.norm(z - recording.z_true, axis=1))

"""Run the filter over a dataset with given noise values, and measure how well the two agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from noiseid_cli.diagnostics.consistency import consistency
from noiseid_cli.diagnostics.errors_known import nees
from noiseid_cli.diagnostics.evaluation import Evaluation
from noiseid_cli.diagnostics.where import misfits
from noiseid_cli.filters.ekf import Filtered
from noiseid_cli.filters.gaussian import gaussian_filter
from noiseid_cli.filters.path_error import path_error
from noiseid_cli.filters.sigma_filter import SigmaFiltered
from noiseid_cli.filters.sigma_points import SigmaWeights
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording, head
from noiseid_cli.models.threads import in_threads


def evaluate(
    model: CompiledModel,
    recordings: Sequence[Recording],
    noise: NoiseValues,
    label: str,
    filter_name: str = "extended",
    weights: SigmaWeights | None = None,
    first: Sequence[int] | None = None,
) -> Evaluation:
    """Consistency of a Kalman filter with the data, and its errors where the truth is known.

    Args:
        model, recordings, noise: the problem; row i of ``noise.m0`` belongs to test i.
        label: ``tuning``, ``start``, ``estimate`` or ``truth``.
        filter_name: ``extended``, ``unscented`` or ``cubature``; kept in the result.
        weights: sigma points of that filter; None for the extended one.
        first: per test, the first sample that counts, from 0: the filter runs through those before it, which were
            fitted, and is scored on the rest, so that its log-likelihood is that of the rest given what came before.

    Raises:
        FilterDivergedError: with test and sample.
    """
    begin = [0] * len(recordings) if first is None else list(first)
    filtered = in_threads(
        lambda test: gaussian_filter(model, recordings[test], noise, test, weights), range(len(recordings))
    )
    loglik = sum(f.loglik for f in filtered)
    for i, (recording, k) in enumerate(zip(recordings, begin, strict=True)):
        if k > 0:
            loglik -= gaussian_filter(model, head(recording, k), noise, i, weights).loglik
    errors = None
    if model.performance is not None and all(r.z_true is not None for r in recordings):
        errors = [path_error(model, r, f.m_filt)[k:] for r, f, k in zip(recordings, filtered, begin, strict=True)]
    innovations = [f.innovation[k:] for f, k in zip(filtered, begin, strict=True)]
    found = consistency(label, innovations, [f.S[k:] for f, k in zip(filtered, begin, strict=True)], loglik, errors)
    counts = np.concatenate([np.isfinite(nu).sum(axis=1) for nu in innovations])
    where = misfits(model, recordings, filtered, begin, found.nis_time, counts)
    return _with_errors(replace(found, filter=filter_name, misfit=where), recordings, filtered, begin)


def _with_errors(
    found: Evaluation,
    recordings: Sequence[Recording],
    filtered: Sequence[Filtered | SigmaFiltered],
    first: Sequence[int],
) -> Evaluation:
    """Add the NEES where every test has its true states."""
    if not all(r.x_true is not None for r in recordings):
        return found
    over_time: Array = np.concatenate([nees(r, f)[k:] for r, f, k in zip(recordings, filtered, first, strict=True)])
    seen = np.isfinite(over_time)
    mean = float(over_time[seen].mean()) if seen.any() else float("nan")
    return replace(found, nees=mean, nees_time=over_time, states=filtered[0].m_filt.shape[1])

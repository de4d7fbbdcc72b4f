"""The outlier gate around any method: fit, find outliers at the fit, leave them out, until the set is at rest.

The set is fixed during a fit, so that every pass, smoother and evaluation sees the same measurements and their
log-likelihoods can be compared. It is decided at the end of a fit on all measurements, and not at the start: a start
that is far off would turn good ones away, while outliers make a first fit wide, and the gate lenient.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from noiseid_cli.estimators.estimate import Estimate
from noiseid_cli.filters.ekf import FilterDivergedError
from noiseid_cli.filters.gate import Gated, OutlierGate, find_outliers
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.recording import Dataset, Recording
from noiseid_cli.pipeline.wording import counted

ROUNDS = 10
LISTED = 8
SUSPICIOUS = 0.01
"""Above this share of the measurements, what is turned away is hardly a handful of outliers."""


def fit_without_outliers(
    fit: Callable[[Dataset], Estimate], model: Callable[[Estimate], CompiledModel], dataset: Dataset, gate: OutlierGate
) -> tuple[Estimate, Dataset]:
    """Fit until the outliers at the fit are those that it left out.

    Args:
        fit: runs the method, always from the same start.
        model: the model at the parameter values of an estimate.
        dataset: all measurements.
        gate: the test.

    Returns:
        The last estimate, its safeguards telling what was left out and its trace holding ``outliers`` (count, 4): test,
        sample and output, each from 1, and the innovation in standard deviations. And the data that it saw.
    """
    used, found = dataset, [Gated(np.zeros(r.y.shape, dtype=bool), r.y) for r in dataset.recordings]
    for round_ in range(1, ROUNDS + 1):
        estimate = fit(used)
        try:
            at_fit = model(estimate)
            now = [find_outliers(at_fit, r, estimate.final, gate, i) for i, r in enumerate(dataset.recordings)]
        except FilterDivergedError as error:
            return _told(estimate, [f"the outlier gate fails at the estimate, nothing more is left out: {error}"]), used
        at_rest = all(np.array_equal(a.dropped, b.dropped) for a, b in zip(found, now, strict=True))
        if at_rest or round_ == ROUNDS:
            break
        found = now
        used = replace(dataset, recordings=tuple(map(_without, dataset.recordings, found)))
    return _report(estimate, dataset, found, gate, round_, at_rest), used


def _without(recording: Recording, gated: Gated) -> Recording:
    """The recording with outliers marked missing."""
    return replace(recording, y=np.where(gated.dropped, np.nan, recording.y))


def _report(
    estimate: Estimate, dataset: Dataset, found: Sequence[Gated], gate: OutlierGate, rounds: int, at_rest: bool
) -> Estimate:
    rows, places = [], []
    for i, (r, gated) in enumerate(zip(dataset.recordings, found, strict=True)):
        for k, j in np.argwhere(gated.dropped).tolist():
            rows.append((i + 1, k + 1, j + 1, gated.deviation[k, j]))
            name = dataset.outputs[j][0] if dataset.outputs else f"output {j + 1}"
            places.append(f"{r.name}, {name} at {r.time[k]:.6g} s ({gated.deviation[k, j]:+.1f} standard deviations)")
    measured = sum(int(np.isfinite(r.y).sum()) for r in dataset.recordings)
    words = f"outlier gate (probability {gate.probability:g} per {gate.per})"
    if not rows:
        return _told(estimate, [f"{words}: none of {measured} measurements left out"])
    more = f"; and {len(places) - LISTED} more" if len(places) > LISTED else ""
    told = [
        f"{words}: {len(rows)} of {counted(measured, 'measurement')} left out, decided at the estimate in "
        f"{counted(rounds, 'fit')}: {'; '.join(places[:LISTED])}{more}"
    ]
    if not at_rest:
        told.append(f"the set of outliers still changed after {ROUNDS} fits; the last one that was fitted is used")
    if len(rows) > SUSPICIOUS * measured:
        told.append(
            f"the outlier gate leaves out {100 * len(rows) / measured:.2g} % of the measurements: so many are no "
            "outliers but a wrong model or wrong noise, and what is left fits too well"
        )
    return replace(_told(estimate, told), trace={**estimate.trace, "outliers": np.array(rows, dtype=float)})


def _told(estimate: Estimate, sentences: list[str]) -> Estimate:
    return replace(estimate, safeguards=(*estimate.safeguards, *sentences))

"""Data that no method can learn from, refused in words before the work begins."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from noiseid_cli.errors import EstimationError
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.recording import Recording


def check_data(model: CompiledModel, recordings: Sequence[Recording], steps_needed: bool = True) -> None:
    """Refuse recordings that do not fit the model, hold no numbers, or are too short.

    Args:
        model: the compiled model.
        recordings: the tests.
        steps_needed: the process noise is to be estimated, which takes two samples at least.

    Raises:
        EstimationError: with the test and, where there is one, the sample.
    """
    if not recordings:
        raise EstimationError("there is no test: the dataset is empty")
    for r in recordings:
        for name, array, width in (("inputs", r.u, model.nu), ("outputs", r.y, model.ny)):
            if array.ndim != 2 or array.shape[1] != width:
                raise EstimationError(
                    f"test {r.name!r}: the {name} have the shape {array.shape}, but the model has {width} {name}"
                )
        if r.samples < 1 or len(r.u) != r.samples or len(r.dt) != r.samples - 1:
            raise EstimationError(
                f"test {r.name!r} has {r.samples} samples of the outputs, {len(r.u)} of the inputs and {len(r.dt)} "
                "intervals: there must be as many inputs as outputs, at least one, and one interval less"
            )
        _refuse(r, "an input", ~np.isfinite(r.u), "inputs must be known")
        _refuse(r, "an output", np.isinf(r.y), "mark what is missing by NaN")
        _refuse(r, "the interval after", ~(np.isfinite(r.dt) & (r.dt > 0.0))[:, None], "time must go on")
    if steps_needed and all(r.samples < 2 for r in recordings):
        raise EstimationError("no test has two samples: without a step nothing can be learnt of the process noise")
    if all(np.isnan(r.y).all() for r in recordings):
        raise EstimationError("nothing was measured: every output of every test is missing")


def _refuse(recording: Recording, what: str, wrong: NDArray[np.bool_], why: str) -> None:
    """Name the first sample with a faulty entry."""
    rows = np.flatnonzero(np.any(wrong, axis=1))
    if rows.size:
        raise EstimationError(
            f"test {recording.name!r}, sample {rows[0] + 1}: {what} is not a usable number ({rows.size} such samples): "
            f"{why}"
        )

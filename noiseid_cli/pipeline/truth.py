"""What is known of the truth behind the scalar unknowns of an estimate."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from noiseid_cli.pipeline.context import Context

if TYPE_CHECKING:
    from collections.abc import Sequence

    from noiseid_cli.estimators.estimate import Estimate
    from noiseid_cli.models.recording import Array, Dataset


def true_parameters(context: Context, dataset: Dataset, estimate: Estimate) -> Array | None:
    """Truth of the estimated scalars, NaN where not known; None of recordings that were not simulated."""
    if estimate.parameters is None or context.experiment.simulate is None:
        return None
    values = dict(context.model.values) | dict(_law(context, dataset))
    if (path := dataset.recordings[-1].parameters_true) is not None:
        # Those at the end of a test in which they change.
        values |= zip((name for name, _, _ in dataset.parameters), path[-1].tolist(), strict=True)
    return np.array([values.get(name, np.nan) for name, _, _ in estimate.parameters.names])


def _law(context: Context, dataset: Dataset) -> Iterator[tuple[str, float]]:
    """Moments of the first state and variances of the noise, by the names that the methods for ensembles give them."""
    section, model = context.experiment.simulate, context.model
    assert section is not None
    first = [q.name for q in model.free_first_states]
    if section.initial_covariance is not None:
        for i, name in enumerate(first):
            yield f"initial mean {name}", 0.0 if section.initial_state is None else section.initial_state[i]
        yield from _entries("initial ", first, section.initial_covariance.matrix())
    for names, C in ((model.noises, dataset.Q_true), (model.outputs, dataset.R_true)):
        if C is not None:
            yield from _entries("", [q.name for q in names], C)


def _entries(of: str, names: Sequence[str], C: Array) -> Iterator[tuple[str, float]]:
    for i, name in enumerate(names):
        yield f"{of}variance {name}", float(C[i, i])
        for j in range(i + 1, len(names)):
            yield f"{of}covariance {name}, {names[j]}", float(C[i, j])

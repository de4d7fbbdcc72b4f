"""Model parameters that change during a simulated test: a friction that rises, a mass that is picked up."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from noiseid_cli.errors import ModelError
from noiseid_cli.models.declarations import unknown_name
from noiseid_cli.models.equations import Model
from noiseid_cli.models.recording import Array


@dataclass(frozen=True)
class ParameterChange:
    """What changes at one time; it stays so until a later change.

    Attributes:
        at: time from the first sample, s; the change takes effect with the first sample that is not earlier.
        set: new values by name, in the parameters' units.
        scale: factors by name, on the values in force until then.
    """

    at: float
    set: Mapping[str, float] = field(default_factory=dict)
    scale: Mapping[str, float] = field(default_factory=dict)


def first_sample(at: float, dt: float) -> int:
    """Number of the first sample that is not earlier than a time; one a rounding error earlier counts."""
    return max(math.ceil(at / dt - 1e-6), 0)


def parameters_over_time(model: Model, changes: Sequence[ParameterChange], samples: int) -> Array:
    """Parameter values at each sample.

    Args:
        model: the parameters, their first values and the sample time.
        changes: in any order; of two at one time the later in the list acts last.
        samples: number of samples N.

    Returns:
        (N, np) row k holds for sample k and the interval that follows.

    Raises:
        ModelError: a name is not a parameter, or the parameter equals the sample time.
    """
    names = list(model.values)
    values = np.tile(model.vector, (samples, 1))
    for change in sorted(changes, key=lambda c: c.at):
        k = first_sample(change.at, model.sample_time)
        for name in (*change.set, *change.scale):
            if name not in names:
                raise ModelError(unknown_name(f"{model.name}: parameter {name}", name, names))
            if name == model.sample_time_parameter:
                raise ModelError(
                    f"{model.name}: parameter {name} equals the sample time, which cannot change in a test."
                )
        for name, value in change.set.items():
            values[k:, names.index(name)] = value
        for name, factor in change.scale.items():
            values[k:, names.index(name)] *= factor
    return values

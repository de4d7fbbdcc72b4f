"""In which unit the process noise is estimated, and what converts it into the other."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from noiseid_cli.models.equations import Model
    from noiseid_cli.models.recording import Dataset
    from noiseid_cli.outcome import Columns

EQUAL = 0.01
"""Intervals that differ from their median by no more than this share count as equal."""


def noise_names(model: Model, density: bool) -> Columns:
    """Name, unit and description of each process noise, the unit per root hertz for a density."""
    return tuple((q.name, per_root_hertz(q.unit) if density else q.unit, q.description) for q in model.noises)


def per_root_hertz(unit: str) -> str:
    """The unit of a noise's density: ``N m`` gives ``N m/√Hz``."""
    return f"{unit or '1'}/√Hz"


def conversion_interval(dataset: Dataset, model: Model, density: bool) -> float | None:
    """The interval between Q per sample and its density, s; see ``UnitResult.interval``."""
    if model.discretisation == "discrete":
        return None
    dt = np.concatenate([recording.dt for recording in dataset.recordings])
    if not dt.size:
        return None
    median = float(np.median(dt))
    equal = bool(np.all(np.abs(dt - median) <= EQUAL * median))
    return median if density or equal else None

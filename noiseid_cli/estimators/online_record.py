"""What the online filters leave behind over recordings: rows of a decimated time axis, as series of an estimate."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from noiseid_cli.estimators.estimate import Columns, Series, plural
from noiseid_cli.filters.ekf import FilterDivergedError
from noiseid_cli.filters.sigma_points import SigmaWeights
from noiseid_cli.filters.srukf import square_root_unscented_filter
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.equations import Model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording

POINTS = 2000
"""Largest number of points of a series."""

TITLES = {
    "parameters": "Estimated values over time",
    "parameters_std": "Their standard deviations, from the filter's own covariance",
    "parameters_true": "True values over time",
    "sensitivity": "A posteriori sensitivity of the states, normalised and summed",
    "sensitivity_open_loop": "Open-loop sensitivity of the states, normalised and summed",
    "open": "Gate of each unknown: 1 adapted, 0 held",
    "states": "Filtered states",
    "states_std": "Standard deviations of the filtered states",
    "states_true": "True states",
}


@dataclass(frozen=True)
class TimeAxis:
    """The samples of several recordings that are kept, on one axis on which the recordings follow each other.

    Attributes:
        recordings: in the order in which they are filtered.
        stride: samples 0, stride, 2 stride, ... of each recording are kept.
    """

    recordings: Sequence[Recording]
    stride: int

    @classmethod
    def of(cls, recordings: Sequence[Recording]) -> TimeAxis:
        """The axis with at most about ``POINTS`` points."""
        return cls(recordings, max(1, -(-sum(r.samples for r in recordings) // POINTS)))

    def at(self) -> Array:
        """(n,) time of each kept sample, s; a recording begins one interval after the end of the one before."""
        parts, begin = [], self.recordings[0].start
        for r in self.recordings:
            parts.append(begin + r.time[:: self.stride] - r.start)
            begin += r.time[-1] - r.start + (r.dt[-1] if len(r.dt) else 0.0)
        return np.concatenate(parts)

    def series(self, name: str, columns: Columns, values: Array) -> Series:
        """One series on this axis; ``values`` may end early, where the filter failed."""
        return Series(name, TITLES[name], ("time", "s"), self.at()[: len(values)], columns, values)

    def states_true(self, columns: Columns, rows: int) -> tuple[Series, ...]:
        """The true states, where every recording carries them."""
        parts = [r.x_true[:: self.stride] for r in self.recordings if r.x_true is not None]
        if len(parts) < len(self.recordings):
            return ()
        return (self.series("states_true", columns, np.concatenate(parts)[:rows]),)

    def parameters_true(self, model: Model, names: Sequence[str], rows: int) -> tuple[Series, ...]:
        """The true values of the named parameters over time, where every recording carries them."""
        parts = [r.parameters_true[:: self.stride] for r in self.recordings if r.parameters_true is not None]
        if not names or len(parts) < len(self.recordings):
            return ()
        at = [list(model.values).index(name) for name in names]
        return (self.series("parameters_true", parameter_columns(model, names), np.concatenate(parts)[:rows, at]),)


def online_safeguards(projections: Mapping[str, int], restacked: int) -> tuple[str, ...]:
    """Sentences on the safeguards that acted."""
    out = [f"{name} was put back on its bound at {plural(k, 'sample')}" for name, k in projections.items() if k]
    if restacked:
        out.append(
            f"{plural(restacked, 'correction')} in which a downdate would have lost more than half of the digits: the "
            "covariance was stacked instead"
        )
    return tuple(out)


def online_settings(options: Any) -> dict[str, str | float | int]:
    """The options in force, for the report; ``options`` is a dataclass."""
    out: dict[str, str | float | int] = {}
    for name, value in asdict(options).items():
        if isinstance(value, Mapping):
            out[name] = ", ".join(f"{key} {number:g}" for key, number in value.items()) or "none"
        elif name != "monitor":
            out[name] = "3 - n" if value is None else value
    return out


def ran_through(axis: TimeAxis, loglik: float) -> str:
    """How a run without a failure ended, in words."""
    total = sum(r.samples for r in axis.recordings)
    return f"the filter ran through {plural(total, 'sample')}; log-likelihood of its innovations {loglik:.6g}"


def parameter_columns(model: Model, names: Sequence[str]) -> Columns:
    """Name, unit and description of parameters."""
    known = {p.name: (p.name, p.unit, p.description) for p in model.parameters}
    return tuple(known[name] for name in names)


def variance_columns(model: Model, at: Sequence[int]) -> Columns:
    """Name, unit and description of variances of the process noise."""
    noises = [model.noises[i] for i in at]
    return tuple((q.name, f"({q.unit})^2" if q.unit else "", f"variance of: {q.description}") for q in noises)


def state_columns(model: Model) -> Columns:
    """Name, unit and description of the states."""
    return tuple((q.name, q.unit, q.description) for q in model.states)


def with_parameters(compiled: CompiledModel, model: Model, names: Sequence[str], values: Array) -> CompiledModel:
    """The compiled model with some of its parameters at other values."""
    return compiled.with_parameters([list(model.values).index(name) for name in names], values)


def frozen_loglik(
    compiled: CompiledModel, recordings: Sequence[Recording], noise: NoiseValues, weights: SigmaWeights
) -> float:
    """Log-likelihood of the square-root unscented filter with everything held; NaN where it fails."""
    try:
        return sum(
            square_root_unscented_filter(compiled, r, noise, weights, i).loglik for i, r in enumerate(recordings)
        )
    except FilterDivergedError:
        return math.nan

"""What a model is confronted with: recordings of inputs and outputs, and where known the truth behind them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Recording:
    """One test: inputs and outputs on one time axis.

    Attributes:
        name: label of the test, unique within its dataset.
        dt: (N-1,) intervals between samples, s.
        u: (N, nu) inputs; row k is held over the interval from sample k to sample k + 1.
        y: (N, ny) outputs; NaN marks a missing value.
        start: time of the first sample, s.
        x_true: (N, nx) true states, where known.
        z_true: (N, nz) true performance outputs (such as a tool position), where known.
        parameters_true: (N, np) true model parameters at each sample, where they change during the test; row k holds
            for y[k] and for the interval that follows.
    """

    name: str
    dt: Array
    u: Array
    y: Array
    start: float = 0.0
    x_true: Array | None = None
    z_true: Array | None = None
    parameters_true: Array | None = None

    @property
    def samples(self) -> int:
        """Number of samples N."""
        return len(self.y)

    @cached_property
    def time(self) -> Array:
        """(N,) time of each sample, s."""
        return self.start + np.concatenate(([0.0], np.cumsum(self.dt)))


def head(recording: Recording, samples: int) -> Recording:
    """The first samples of a recording, at least one and at most all of them."""
    n = min(max(samples, 1), recording.samples)
    x_true, z_true = (None if a is None else a[:n] for a in (recording.x_true, recording.z_true))
    return replace(
        recording, dt=recording.dt[: n - 1], u=recording.u[:n], y=recording.y[:n], x_true=x_true, z_true=z_true
    )


@dataclass(frozen=True)
class Dataset:
    """Recordings that share one model and one set of unknowns.

    Attributes:
        name: label of the dataset.
        model: name of the model that the columns belong to.
        recordings: the tests; their lengths may differ.
        inputs, outputs, states, performances, parameters: (name, unit, description) of each column.
        Q_true: (nv, nv) covariance of the process noise that made the data, where known.
        R_true: (ny, ny) covariance of the measurement noise that made the data, where known.
        notes: what was done to the data on the way in (rows dropped, gaps marked, ...), in sentences.
    """

    name: str
    model: str
    recordings: tuple[Recording, ...]
    inputs: tuple[tuple[str, str, str], ...] = ()
    outputs: tuple[tuple[str, str, str], ...] = ()
    states: tuple[tuple[str, str, str], ...] = ()
    performances: tuple[tuple[str, str, str], ...] = ()
    parameters: tuple[tuple[str, str, str], ...] = ()
    Q_true: Array | None = None
    R_true: Array | None = None
    notes: tuple[str, ...] = field(default=())

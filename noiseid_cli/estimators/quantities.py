"""The figures that people read off an estimate, with their derivatives in the free coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.estimators.unknowns import Unknowns
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array

KINDS = {"Q": "process_noise", "R": "measurement_noise", "P0": "initial"}

Scale = Literal["log", "fisher", "plain"]


@dataclass(frozen=True)
class Figure:
    """One figure of an estimate.

    Attributes:
        metric, index, unit: as in the tidy table of results, such as ``process_noise_std`` and ``vm1``.
        value: its value at the estimate.
        slope: (d,) its derivative in the free coordinates.
        scale: where its error is nearest to normal: ``log`` for standard deviations, ``fisher`` (the inverse hyperbolic
            tangent; Fisher 1921) for correlations, ``plain`` for means and parameters.
        letter: Q, R, P0, m0 or parameters; place: the entry there, (i, j) with i >= j.
    """

    metric: str
    index: str
    unit: str
    value: float
    slope: Array
    scale: Scale
    letter: str
    place: tuple[int, int]

    @property
    def scaled_slope(self) -> Array:
        """(d,) derivative on the figure's own scale."""
        if self.scale == "log":
            return self.slope / self.value
        if self.scale == "fisher":
            return self.slope / (1.0 - self.value**2)
        return self.slope

    def interval(self, half: float) -> tuple[float, float]:
        """Ends of the interval that reaches ``half`` to both sides on the figure's own scale."""
        if self.scale == "log":
            return self.value * float(np.exp(-half)), self.value * float(np.exp(half))
        if self.scale == "fisher":
            centre = float(np.arctanh(self.value))
            return float(np.tanh(centre - half)), float(np.tanh(centre + half))
        return self.value - half, self.value + half

    @property
    def whole(self) -> tuple[float, float]:
        """All values that it can have."""
        return {"log": (0.0, np.inf), "fisher": (-1.0, 1.0), "plain": (-np.inf, np.inf)}[self.scale]

    def in_words(self) -> str:
        """Such as ``the std of vm1`` or ``the correlation of vm2 and vm1``."""
        word = self.metric.rsplit("_", 1)[-1]
        whose = "the first state's" if self.letter in ("P0", "m0") else "the"
        return f"{whose} {word} of {self.index.replace(', ', ' and ')}"


def figures(model: CompiledModel, unknowns: Unknowns, noise: NoiseValues) -> list[Figure]:
    """Standard deviations, correlations and means that are unknown, in the order of ``Unknowns.pack``.

    A standard deviation that is held, and a correlation that is held or is zero by structure, is not among them.
    """
    names = {"Q": model.noises, "R": model.outputs, "P0": model.states}
    parts = [
        (letter, structure, structure.jacobian(structure.coordinates(value)), value)
        for letter, structure, (value,) in unknowns.covariances(noise)
    ]
    size = sum(len(part[2]) for part in parts) + (model.nx if unknowns.m0 else 0)
    out: list[Figure] = []
    at = 0
    for letter, structure, directions, value in parts:
        slopes = np.zeros((size, *value.shape))
        slopes[at : at + len(directions)] = directions
        out += _of_covariance(letter, structure, value, slopes, names[letter], model.units)
        at += len(directions)
    if unknowns.m0:
        scale = unknowns.mean_scale(noise)
        for i in np.flatnonzero(np.diag(noise.P0) > 0.0):
            slope = np.zeros(size)
            slope[at + i] = scale[i]
            name, unit = model.states[i], model.units.get(model.states[i], "")
            out.append(
                Figure("initial_mean", name, unit, float(noise.m0[0, i]), slope, "plain", "m0", (int(i), int(i)))
            )
    return out


def _of_covariance(
    letter: str,
    structure: CovarianceStructure,
    value: Array,
    slopes: Array,
    names: Sequence[str],
    units: dict[str, str],
) -> list[Figure]:
    """Standard deviations, then correlations, of one covariance; slopes are (d, p, p)."""
    s = np.sqrt(np.diag(value))
    kind = KINDS[letter]
    out = []
    for i, name in enumerate(names):
        if (i, i) not in structure.held:
            slope = slopes[:, i, i] / (2.0 * s[i])
            unit = units.get(name, "")
            out.append(Figure(f"{kind}_std", name, unit, float(s[i]), slope, "log", letter, (i, i)))
    if structure.scale:
        return out
    for i in range(len(names)):
        for j in range(i):
            if (i, j) in structure.held or structure.block_of[i] != structure.block_of[j]:
                continue
            rho = float(value[i, j] / (s[i] * s[j]))
            shrink = 0.5 * rho * (slopes[:, i, i] / value[i, i] + slopes[:, j, j] / value[j, j])
            slope = slopes[:, i, j] / (s[i] * s[j]) - shrink
            index = f"{names[i]}, {names[j]}"
            out.append(Figure(f"{kind}_correlation", index, "", rho, slope, "fisher", letter, (i, j)))
    return out

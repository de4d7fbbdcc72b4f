"""Where in the motion the misfit sits: the normalised innovation squared against time, states and inputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from noiseid_cli.models.recording import Array, Recording

if TYPE_CHECKING:
    from noiseid_cli.filters.ekf import Filtered
    from noiseid_cli.filters.sigma_filter import SigmaFiltered
    from noiseid_cli.models.compiled import CompiledModel

BINS = 10
"""Each quantity is cut into so many ranges of equally many samples."""


@dataclass(frozen=True)
class Misfit:
    """Normalised innovation squared over ranges of one quantity.

    Attributes:
        name, unit: of the quantity: ``time`` within a test, a predicted state, or an input.
        edges: (b + 1,) borders of the ranges.
        nis: (b,) mean normalised innovation squared per scalar measurement in each; 1 for a consistent filter.
        counts: (b,) number of scalar measurements in each.
    """

    name: str
    unit: str
    edges: Array
    nis: Array
    counts: Array

    @property
    def unevenness(self) -> float:
        """Share of the mean NIS by which the ranges scatter, chance taken away; 0 where it is no more than chance."""
        if not self.counts.sum() > 0:
            return 0.0
        weight = self.counts / self.counts.sum()
        mean = float(weight @ self.nis)
        if not 0 < mean < np.inf:
            return 0.0
        chance = float(weight @ (2.0 / self.counts))
        return float(np.sqrt(max(weight @ (self.nis / mean - 1.0) ** 2 - chance, 0.0)))

    def worst(self) -> tuple[float, float, float]:
        """Borders of the range with the greatest NIS, and that NIS."""
        i = int(np.argmax(self.nis))
        return float(self.edges[i]), float(self.edges[i + 1]), float(self.nis[i])


def misfits(
    model: CompiledModel,
    recordings: Sequence[Recording],
    filtered: Sequence[Filtered | SigmaFiltered],
    first: Sequence[int],
    nis_time: Array,
    counts: Array,
) -> tuple[Misfit, ...]:
    """NIS against time, each predicted state and each input.

    Args:
        model, recordings, filtered: the problem, and the filter's results per test.
        first: per test, the first sample that counts.
        nis_time: (samples of all tests,) normalised innovation squared per measurement, NaN where nothing was measured.
        counts: (samples of all tests,) number of scalar measurements.
    """
    out = []
    columns: list[tuple[str, str, list[Array]]] = [
        ("time", "s", [r.time - r.time[0] for r in recordings]),
        *((name, model.units.get(name, ""), [f.m_pred[:, i] for f in filtered]) for i, name in enumerate(model.states)),
        *((name, model.units.get(name, ""), [r.u[:, i] for r in recordings]) for i, name in enumerate(model.inputs)),
    ]
    for name, unit, parts in columns:
        values = np.concatenate([part[k:] for part, k in zip(parts, first, strict=True)])
        found = _ranges(name, unit, values, nis_time, counts)
        if found is not None:
            out.append(found)
    return tuple(out)


def _ranges(name: str, unit: str, values: Array, nis: Array, counts: Array) -> Misfit | None:
    """One quantity; None if it hardly moves, or nothing was measured."""
    seen = (counts > 0) & np.isfinite(values)
    if not seen.any():
        return None
    values, weight = values[seen], counts[seen].astype(np.float64)
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, BINS + 1)))
    if len(edges) < 3:
        return None
    at = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    total = np.bincount(at, weight, len(edges) - 1).astype(np.float64)
    sums = np.bincount(at, weight * nis[seen], len(edges) - 1).astype(np.float64)
    if not np.all(total > 0):
        return None
    return Misfit(name, unit, edges, sums / total, total)

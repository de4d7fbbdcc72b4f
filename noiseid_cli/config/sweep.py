"""The points of a sweep: the same experiment with some settings replaced, and each of them checked."""

from __future__ import annotations

import hashlib
import itertools
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from noiseid_cli.config import overrides
from noiseid_cli.config.document import Document, Path
from noiseid_cli.config.load import LoadedExperiment, validate
from noiseid_cli.errors import ConfigError, Problem

if TYPE_CHECKING:
    from noiseid_cli.config.schema_sweep import Axis

STREAM = 3
"""First entry of the spawn key of the streams that values are drawn from."""


@dataclass(frozen=True)
class SweepPoint:
    """One point.

    Attributes:
        index: its number, from 0.
        name: ``point-000``.
        values: the value of each axis.
        entries: which value of each axis that is, from 0.
    """

    index: int
    name: str
    values: dict[str, Any]
    entries: dict[str, int]

    @property
    def words(self) -> str:
        """The values, such as ``samples = 500, noise = [0.5]``."""
        return ", ".join(f"{axis} = {value}" for axis, value in self.values.items())


def sweep_points(loaded: LoadedExperiment) -> list[SweepPoint]:
    """The points of an experiment, in order; none where it has no sweep.

    A drawn value depends on the seed, the settings that it replaces and its own number only: more values keep those
    that were there.
    """
    sweep = loaded.experiment.sweep
    if sweep is None:
        return []
    values = {name: _values(axis, loaded.experiment.seed) for name, axis in sweep.axes.items()}
    numbers = [range(len(v)) for v in values.values()]
    chosen = itertools.product(*numbers) if sweep.combine == "product" else zip(*numbers, strict=True)
    points = []
    for index, entries in enumerate(chosen):
        which = dict(zip(values, entries, strict=True))
        points.append(SweepPoint(index, f"point-{index:03d}", {k: values[k][i] for k, i in which.items()}, which))
    return points


def _values(axis: Axis, seed: int) -> list[Any]:
    """The values of one axis, given or drawn."""
    if axis.draw is None:
        assert axis.values is not None
        return list(axis.values)
    import numpy as np

    assert axis.count is not None
    name = int.from_bytes(hashlib.sha256("\n".join(axis.vary).encode()).digest()[:4], "big")
    out = []
    for i in range(axis.count):
        rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(STREAM, name, i))))
        out.append(_draw(rng, axis.draw.model_dump()))
    return out


def _draw(rng: Any, options: dict[str, Any]) -> float:
    import math

    kind = options["kind"]
    if kind == "uniform":
        return float(rng.uniform(options["lowest"], options["highest"]))
    if kind == "log_uniform":
        return math.exp(float(rng.uniform(math.log(options["lowest"]), math.log(options["highest"]))))
    z = float(rng.standard_normal())
    if kind == "normal":
        return float(options["mean"] + options["std"] * z)
    return float(options["median"] * options["spread"] ** z)


def load_point(loaded: LoadedExperiment, point: SweepPoint) -> LoadedExperiment:
    """The experiment at one point: without a sweep, with the point's values in place.

    Raises:
        ConfigError: the values do not fit; each problem stands at the place of the value in the sweep.
    """
    sweep = loaded.experiment.sweep
    assert sweep is not None
    document = replace(
        loaded.document,
        data={k: deepcopy(v) for k, v in loaded.document.data.items() if k != "sweep"},
        places=dict(loaded.document.places),
        sources=dict(loaded.document.sources),
        problems=[],
    )
    problems = []
    for name, axis in sweep.axes.items():
        origin = _origin(loaded.document, name, point.entries[name], axis)
        for path in axis.vary:
            try:
                overrides.put(document, overrides.parse_path(path), deepcopy(point.values[name]), origin)
            except overrides.PathError as error:
                problems.append(loaded.problem(("sweep", "axes", name, "vary"), str(error)))
    if not problems:
        experiment, problems = validate(document)
        if experiment is not None and not problems:
            return LoadedExperiment(experiment, loaded.file, document)
    raise ConfigError(str(loaded.file), problems)


def at_point(problem: Problem, point: SweepPoint) -> Problem:
    """The same problem, with the point that has it."""
    return replace(problem, message=f"{problem.message} (at {point.name}: {point.words})")


def _origin(document: Document, name: str, entry: int, axis: Axis) -> overrides.Origin:
    """Where the value of an axis stands: in the file, or on the command line."""
    path: Path = ("sweep", "axes", name, *(("values", entry) if axis.values is not None else ("draw",)))
    for length in range(len(path), 0, -1):
        if path[:length] in document.sources:
            return document.sources[path[:length]]
        if path[:length] in document.places:
            return document.places[path[:length]]
    return "the sweep"

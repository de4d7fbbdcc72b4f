"""Units of work: what is to be made, under which name, and whether it is there already.

A unit writes one file, whose name ends in the first digits of the unit's key: the hash of every setting and input that
it depends on. A file that is there is done; other settings make another file, and nothing is overwritten.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from noiseid_cli.config.methods import METHOD_OPTIONS, MethodOptions
from noiseid_cli.config.suggest import did_you_mean
from noiseid_cli.errors import DataError, EstimationError
from noiseid_cli.pipeline.context import Context

# Raised by hand when a stage's meaning changes, so that old files are made anew.
STAGE_VERSION = {"simulate": 1, "import": 1, "estimate": 1}


@dataclass(frozen=True)
class DatasetUnit:
    """One dataset to be simulated or imported.

    Attributes:
        name: ``replicate-000``, or the name of the recording or of the experiment.
        key: 64 hex digits.
        path: the file.
        replicate: number of the simulated replicate, from 0.
        recordings: names of the recordings to import; empty for a simulation.
    """

    name: str
    key: str
    path: Path
    replicate: int = 0
    recordings: tuple[str, ...] = ()

    @property
    def done(self) -> bool:
        """The file is there."""
        return self.path.exists()


@dataclass(frozen=True)
class EstimateUnit:
    """One method, from one start, on one dataset.

    Attributes:
        dataset: the dataset's unit.
        label: label of the method in the experiment.
        options: the method's options.
        start: number of the start, from 0.
        scale: factor on the start of the process noise; measurement_scale: on that of the measurement noise.
        key, path: as in ``DatasetUnit``.
    """

    dataset: DatasetUnit
    label: str
    options: MethodOptions
    start: int
    scale: float
    measurement_scale: float
    key: str
    path: Path

    @property
    def name(self) -> str:
        """Label of the unit, as it is shown."""
        return f"{self.dataset.name}/{self.label}/start-{self.start}"

    @property
    def done(self) -> bool:
        """The file is there."""
        return self.path.exists()


def dataset_units(context: Context) -> list[DatasetUnit]:
    """The datasets of an experiment, in order.

    Raises:
        DataError: a recording's file cannot be read.
    """
    experiment = context.experiment
    model = {"model": context.loaded.section_key("model"), "equations": context.model_digest}
    units = []
    if experiment.simulate is not None:
        # The number of replicates is left out: asking for more keeps those that are there.
        settings = experiment.simulate.model_dump(mode="json", exclude={"replicates"})
        for replicate in range(experiment.simulate.replicates):
            key = _key("simulate", model, settings, {"seed": experiment.seed, "replicate": replicate})
            name = f"replicate-{replicate:03d}"
            units.append(DatasetUnit(name, key, _path(context, "datasets", name, key), replicate))
    if experiment.import_ is not None:
        from noiseid_cli.recordings.readers import source_digest

        section = experiment.import_
        names = list(section.recordings)
        groups = (
            [(name, (name,)) for name in names] if section.group == "separate" else [(experiment.experiment, names)]
        )
        common = section.model_dump(mode="json", exclude={"recordings", "group"})
        for name, members in groups:
            sources = [
                {
                    "name": member,
                    "settings": section.recordings[member].model_dump(mode="json", exclude={"file"}),
                    "sha256": source_digest(context.loaded.resolve(section.recordings[member].file)),
                }
                for member in members
            ]
            key = _key("import", model, common, sources)
            units.append(DatasetUnit(name, key, _path(context, "datasets", name, key), 0, tuple(members)))
    return units


def estimate_units(context: Context, methods: list[str] | None = None) -> list[EstimateUnit]:
    """The estimation units of an experiment: dataset by dataset, method by method, start by start.

    Args:
        context: the experiment.
        methods: labels or method names to run; all of the experiment's if not given. A known method that the
            experiment does not list runs with its default options.

    Raises:
        EstimationError: a method is not known, or the experiment estimates nothing.
    """
    section = context.experiment.estimate
    if section is None:
        raise EstimationError("the experiment has no `estimate` section: it says how to get data, not what to find")
    chosen = _choose(dict(section.methods), methods)
    common = section.model_dump(mode="json", exclude={"methods", "starts"})
    measurement = section.starts.measurement_scale or (1.0,) * len(section.starts.scale)
    units = []
    for dataset in dataset_units(context):
        for label, options in chosen.items():
            for start, (scale, measurement_scale) in enumerate(zip(section.starts.scale, measurement, strict=True)):
                settings = options.model_dump(mode="json")
                factors = {"scale": scale, "measurement_scale": measurement_scale}
                key = _key("estimate", dataset.key, common, settings, factors)
                name = f"{dataset.name}.{label}.start-{start}"
                path = _path(context, "results", name, key)
                units.append(EstimateUnit(dataset, label, options, start, scale, measurement_scale, key, path))
    return units


def require_datasets(context: Context, units: Sequence[EstimateUnit]) -> None:
    """Refuse to estimate from datasets that are not there.

    Raises:
        DataError: with the command that makes them.
    """
    missing = list(dict.fromkeys(unit.dataset for unit in units if not unit.dataset.done))
    if missing:
        stage = "simulate" if context.experiment.simulate is not None else "import"
        raise DataError(
            f"{len(missing)} dataset(s) of {context.experiment.experiment} are not there, the first is "
            f"{missing[0].path}: run `noiseid {stage}` first, or `noiseid run` for all stages"
        )


def _choose(listed: dict[str, MethodOptions], wanted: list[str] | None) -> dict[str, MethodOptions]:
    """Pick methods by label, else by method name, else with default options."""
    if not wanted:
        return listed
    out: dict[str, MethodOptions] = {}
    for name in wanted:
        by_method = {label: options for label, options in listed.items() if options.method == name}
        if name in listed:
            out[name] = listed[name]
        elif by_method:
            out |= by_method
        elif name in METHOD_OPTIONS:
            out[name] = METHOD_OPTIONS[name].model_validate({"method": name})
        else:
            known = [*listed, *(m for m in METHOD_OPTIONS if m not in listed)]
            raise EstimationError(f"{name!r} is not a method; known: {', '.join(known)}{did_you_mean(name, known)}")
    return out


def _key(stage: str, *parts: Any) -> str:
    text = json.dumps([stage, STAGE_VERSION[stage], *parts], sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _path(context: Context, folder: str, name: str, key: str) -> Path:
    return context.folder / folder / f"{name}-{key[:8]}.h5"

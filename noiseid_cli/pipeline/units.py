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
from noiseid_cli.pipeline.starts import Start, starts

# Raised by hand when a stage's meaning changes, so that old files are made anew.
STAGE_VERSION = {"simulate": 1, "import": 1, "estimate": 1, "report": 1}


@dataclass(frozen=True)
class DatasetUnit:
    """One dataset to be simulated or imported.

    Attributes:
        name: ``replicate-000``, or the name of the recording or of the experiment.
        key: 64 hex digits.
        path: the file.
        replicate: number of the simulated replicate, from 0.
        recordings: names of the recordings to import; empty for a simulation.
        held_out: no method sees it; estimates are scored on it.
    """

    name: str
    key: str
    path: Path
    replicate: int = 0
    recordings: tuple[str, ...] = ()
    held_out: bool = False

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
        start: where it starts from.
        held_out: the dataset that the estimate is scored on besides its own.
        key, path: as in ``DatasetUnit``.
    """

    dataset: DatasetUnit
    label: str
    options: MethodOptions
    start: Start
    held_out: DatasetUnit | None
    key: str
    path: Path

    @property
    def needs(self) -> tuple[DatasetUnit, ...]:
        """The datasets that it reads."""
        return (self.dataset,) if self.held_out is None else (self.dataset, self.held_out)

    @property
    def name(self) -> str:
        """Label of the unit, as it is shown."""
        return f"{self.dataset.name}/{self.label}/start-{self.start.index}"

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
        settings = experiment.simulate.model_dump(mode="json", exclude={"replicates", "held_out"})
        for replicate in range(experiment.simulate.replicates):
            key = digest("simulate", model, settings, {"seed": experiment.seed, "replicate": replicate})
            name = f"replicate-{replicate:03d}"
            units.append(DatasetUnit(name, key, _path(context, "datasets", name, key), replicate))
        if experiment.simulate.held_out is not None:
            other = experiment.simulate.held_out.model_dump(mode="json")
            key = digest("simulate", model, settings, other, {"seed": experiment.seed})
            units.append(DatasetUnit("held-out", key, _path(context, "datasets", "held-out", key), held_out=True))
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
            key = digest("import", model, common, sources)
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
    chosen = chosen_methods(context, methods)
    section = context.experiment.estimate
    assert section is not None
    common = section.model_dump(mode="json", exclude={"methods", "starts"})
    datasets = dataset_units(context)
    held_out = next((dataset for dataset in datasets if dataset.held_out), None)
    scored_on = held_out.key if held_out else None
    units = []
    for dataset in datasets:
        if dataset.held_out:
            continue
        for label, options in chosen.items():
            for start in starts(context):
                settings = options.model_dump(mode="json")
                factors = [start.factors, start.measurement_factor]
                key = digest("estimate", dataset.key, common, settings, factors, scored_on)
                path = _path(context, "results", f"{dataset.name}.{label}.start-{start.index}", key)
                units.append(EstimateUnit(dataset, label, options, start, held_out, key, path))
    return units


def waiting_units(context: Context, units: Sequence[EstimateUnit], force: bool = False) -> list[EstimateUnit]:
    """The units that are to be done and cannot be, because a dataset that they need is not there.

    Args:
        context: the experiment.
        units: all units.
        force: those that are done are to be done again.

    Raises:
        DataError: no unit is done or can be; it names the command that makes the datasets.
    """
    todo = [unit for unit in units if force or not unit.done]
    waiting = [unit for unit in todo if not all(dataset.done for dataset in unit.needs)]
    if waiting and len(waiting) == len(units):
        folder = context.folder / "datasets"
        wanted = {dataset.path for unit in units for dataset in unit.needs}
        others = len([path for path in folder.glob("*.h5") if path not in wanted])
        hint = f" ({others} of other settings: give each command the same --set and --seed)" if others else ""
        raise DataError(
            f"{folder} lacks datasets of these settings{hint}: run `noiseid {data_stage(context)}` first, "
            "or `noiseid run` for all stages"
        )
    return waiting


def data_stage(context: Context) -> str:
    """The stage that makes the datasets: ``simulate`` or ``import``."""
    return "simulate" if context.experiment.simulate is not None else "import"


def chosen_methods(context: Context, wanted: Sequence[str] | None = None) -> dict[str, MethodOptions]:
    """Options of the methods to run, by label.

    Args:
        context: the experiment.
        wanted: as in ``estimate_units``; a name is looked for among the labels, then among the methods.

    Raises:
        EstimationError: a method is not known, or the experiment estimates nothing.
    """
    section = context.experiment.estimate
    if section is None:
        raise EstimationError("the experiment has no `estimate` section: it says how to get data, not what to find")
    listed = dict(section.methods)
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


def digest(stage: str, *parts: Any) -> str:
    """Key of a stage that depends on these parts: 64 hexadecimal digits."""
    text = json.dumps([stage, STAGE_VERSION[stage], *parts], sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _path(context: Context, folder: str, name: str, key: str) -> Path:
    return context.folder / folder / f"{name}-{key[:8]}.h5"

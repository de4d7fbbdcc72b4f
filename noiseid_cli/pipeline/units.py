"""Units of work: what is to be made, under which name, and whether it is there already.

A unit writes one file, whose name ends in the first digits of the unit's key: the hash of every setting and input that
it depends on. A file that is there is done; other settings make another file, and nothing is overwritten.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from noiseid_cli.config.methods import METHOD_OPTIONS, MethodOptions
from noiseid_cli.config.suggest import did_you_mean
from noiseid_cli.errors import ConfigError, DataError, EstimationError
from noiseid_cli.pipeline.context import Context
from noiseid_cli.pipeline.keys import digest, unit_path
from noiseid_cli.pipeline.starts import Start, starts


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
        ConfigError: recordings that it names cannot be read.
    """
    simulated = context.experiment.simulate is not None
    return _simulated_units(context) if simulated else _imported_units(context)


def _model(context: Context) -> dict[str, str]:
    return {"model": context.loaded.section_key("model"), "equations": context.model_digest}


def _simulated_units(context: Context) -> list[DatasetUnit]:
    section, seed, model = context.experiment.simulate, context.experiment.seed, _model(context)
    assert section is not None
    # The number of replicates is left out: asking for more keeps those that are there.
    settings = section.model_dump(mode="json", exclude={"replicates", "held_out"})
    units = []
    for replicate in range(section.replicates):
        key = digest("simulate", model, settings, {"seed": seed, "replicate": replicate})
        name = f"replicate-{replicate:03d}"
        units.append(DatasetUnit(name, key, unit_path(context.folder, "datasets", name, key), replicate))
    if section.held_out is not None:
        key = digest("simulate", model, settings, section.held_out.model_dump(mode="json"), {"seed": seed})
        units.append(
            DatasetUnit("held-out", key, unit_path(context.folder, "datasets", "held-out", key), held_out=True)
        )
    return units


def _imported_units(context: Context) -> list[DatasetUnit]:
    section, model = context.experiment.import_, _model(context)
    assert section is not None
    names = tuple(section.recordings)
    separate = section.group == "separate"
    groups = [(name, (name,)) for name in names] if separate else [(context.experiment.experiment, names)]
    common = section.model_dump(mode="json", exclude={"recordings", "group"})
    digests = _recording_digests(context)
    units = []
    for name, members in groups:
        sources = [
            {
                "name": member,
                "settings": section.recordings[member].model_dump(mode="json", exclude={"file"}),
                "sha256": digests[member],
            }
            for member in members
        ]
        key = digest("import", model, common, sources)
        units.append(DatasetUnit(name, key, unit_path(context.folder, "datasets", name, key), 0, members))
    return units


def _recording_digests(context: Context) -> dict[str, str]:
    """SHA-256 of each recording: other content makes another dataset, another name or folder does not.

    Raises:
        ConfigError: with every file that cannot be read, and its place in the experiment.
    """
    from noiseid_cli.recordings.readers import source_digest

    section = context.experiment.import_
    assert section is not None
    digests, problems = {}, []
    for name, source in section.recordings.items():
        try:
            digests[name] = source_digest(context.loaded.resolve(source.file))
        except DataError as error:
            problems.append(context.loaded.problem(("import", "recordings", name, "file"), str(error)))
    if problems:
        raise ConfigError(str(context.loaded.file), problems)
    return digests


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
                path = unit_path(context.folder, "results", f"{dataset.name}.{label}.start-{start.index}", key)
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

"""Units of work: what is to be made, under which name, and whether it is there already.

A unit writes one file, whose name ends in the first digits of the unit's key: the hash of every setting and input that
it depends on. A file that is there is done; other settings make another file, and nothing is overwritten.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from noiseid_cli.config.check_methods import refusal
from noiseid_cli.config.method_base import MethodOptions
from noiseid_cli.config.methods import METHOD_OPTIONS
from noiseid_cli.config.suggest import did_you_mean
from noiseid_cli.errors import ConfigError, DataError, EstimationError
from noiseid_cli.pipeline.context import Context
from noiseid_cli.pipeline.data_units import own_dataset_units
from noiseid_cli.pipeline.keys import digest, unit_path
from noiseid_cli.pipeline.starts import starts
from noiseid_cli.pipeline.unit import DatasetUnit, EstimateUnit


def dataset_units(context: Context) -> list[DatasetUnit]:
    """The datasets of an experiment, in order; points of a sweep that need the same one share it.

    Raises:
        ConfigError: recordings that it names cannot be read.
    """
    units: dict[Path, DatasetUnit] = {}
    for _, own in _at_points(context):
        for unit in own:
            units.setdefault(unit.path, unit)
    return list(units.values())


def _at_points(context: Context) -> Iterator[tuple[Context, list[DatasetUnit]]]:
    """The experiment, or it at each point of its sweep, with its datasets."""
    if not context.points:
        yield context, own_dataset_units(context)
    for point in context.points:
        here = context.at(point.index)
        yield (
            here,
            [
                replace(unit, name=f"{point.name}/{unit.name}", point=point.name, point_index=point.index)
                for unit in own_dataset_units(here)
            ],
        )


def estimate_units(context: Context, methods: list[str] | None = None) -> list[EstimateUnit]:
    """The estimation units of an experiment: point by point, dataset by dataset, method by method, start by start.

    Args:
        context: the experiment.
        methods: labels or method names to run; all of the experiment's if not given. A known method that the
            experiment does not list runs with its default options.

    Raises:
        EstimationError: a method is not known, or the experiment estimates nothing.
    """
    chosen_methods(context, methods)  # a wrong name is told before anything else
    return [unit for here, datasets in _at_points(context) for unit in _own_estimate_units(here, datasets, methods)]


def _own_estimate_units(context: Context, datasets: list[DatasetUnit], methods: list[str] | None) -> list[EstimateUnit]:
    chosen = chosen_methods(context, methods)
    section = context.experiment.estimate
    assert section is not None
    common = section.model_dump(mode="json", exclude={"methods", "starts", "continue_from"})
    earlier = earlier_result(context)
    # Its content counts, not its place.
    before = [] if earlier is None else [_sha256(context, earlier)]
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
                key = digest("estimate", dataset.key, common, settings, factors, scored_on, *before)
                path = unit_path(context, "results", f"{dataset.own_name}.{label}.start-{start.index}", key)
                units.append(EstimateUnit(dataset, label, options, start, held_out, key, path))
    return units


def earlier_result(context: Context) -> Path | None:
    """The result that estimates go on from, if the experiment names one."""
    section = context.experiment.estimate
    named = None if section is None else section.continue_from
    return None if named is None else context.loaded.resolve(named)


def _sha256(context: Context, path: Path) -> str:
    import hashlib

    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        where = ("estimate", "continue_from")
        text = f"{path}: {error.strerror}; name a result of recursive-ml"
        raise ConfigError(str(context.loaded.file), [context.loaded.problem(where, text)]) from None


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
        EstimationError: a method is not known, cannot estimate what is asked, or the experiment estimates nothing.
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
    for options in out.values():
        if why := refusal(options, section):
            raise EstimationError(why)
    return out

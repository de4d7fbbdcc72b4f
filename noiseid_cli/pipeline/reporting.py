"""The `report` stage: gather the results of an experiment and write its report."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from noiseid_cli.errors import DataError, machine_error
from noiseid_cli.pipeline.assessment import fitted_part
from noiseid_cli.pipeline.bound import bounds
from noiseid_cli.pipeline.context import Context
from noiseid_cli.pipeline.facts import dataset_facts, model_facts, named_at_point, published_facts, sweep_facts
from noiseid_cli.pipeline.keys import digest
from noiseid_cli.pipeline.units import chosen_methods, estimate_units

if TYPE_CHECKING:
    from noiseid_cli.report import Study
    from noiseid_cli.report.tables import Table

T = TypeVar("T")

_INDEX = ".report.json"
"""Kept in the report's folder: what it was made from, and the files that it wrote."""


@dataclass(frozen=True)
class Reported:
    """The results in short, and the report on them.

    Attributes:
        tables: the main tables, for the terminal.
        unfinished: number of results that did not converge.
        warnings: what is missing, in sentences.
        page: the file to open; None where no report was asked for.
        written: the report was written now; False if one of the same results was there.
    """

    tables: list[Table]
    unfinished: int
    warnings: list[str]
    page: Path | None = None
    written: bool = False


def show_results(context: Context, methods: list[str] | None = None) -> Reported:
    """The results that are there, for the terminal only.

    Raises:
        DataError: there is no result that can be read.
    """
    return _shown(gather(context, methods)[0])


def make_report_stage(context: Context, methods: list[str] | None = None, anew: bool = True) -> Reported:
    """Write the report of all results that are there.

    Args:
        context: the experiment.
        methods: as in ``estimate_units``.
        anew: write it even if nothing has changed since the last one.

    Raises:
        MachineError: the disk is full or faulty.
        DataError: there is no result that can be read, or the report cannot be written for another reason.
    """
    from noiseid_cli.storage.atomic import publish
    from noiseid_cli.storage.lock import locked

    study, sources = gather(context, methods)
    shown = _shown(study)
    folder = context.folder / "report"
    settings = context.experiment.report.model_dump(mode="json")
    key = digest(
        "report",
        settings,
        repr((study.published, study.estimates, study.claims)),
        study.environment,
        study.warnings,
        study.reproduce,
        *map(_stamp, sources),
    )
    before = _read_index(folder)
    if not anew and before.get("key") == key and all((folder / name).is_file() for name in before["files"]):
        return replace(shown, page=folder / before["files"][0])
    context.say("report: tables, figures and pages")
    try:
        # Two reports at once would mix; each takes seconds, so that waiting needs no asking.
        with locked(context.folder, context.say, wait=True, name=".report.lock"):
            names = _write(study, folder, context.experiment.report.formats, before.get("files", ()))
            index = json.dumps({"key": key, "files": names}, indent=1)
            publish(folder / _INDEX, index.encode())
    except OSError as error:
        said = f"the report cannot be written: {error.filename or folder}"
        raise machine_error(error, said) or DataError(f"{said}: {error.strerror}; mend that, or use --out") from error
    return replace(shown, page=folder / names[0], written=True)


def _shown(study: Study) -> Reported:
    from noiseid_cli.report import terminal_tables

    unfinished = sum(result.estimate.status != "converged" for result in study.results)
    return Reported(terminal_tables(study), unfinished, study.warnings)


def _write(study: Study, folder: Path, formats: Collection[str], before: Collection[str]) -> list[str]:
    """Write the report; give the names of its files in the folder, the page to open first."""
    from noiseid_cli.report import make_report

    made = make_report(study, folder, formats)
    files = [path for path in (made.html, made.markdown, *made.tables, *made.figures) if path is not None]
    names = [path.relative_to(folder).as_posix() for path in files]
    # A table or figure of an earlier report that this one does not have would be read as part of it.
    for name in set(before) - set(names):
        (folder / name).unlink(missing_ok=True)
    return names


def _stamp(path: Path) -> tuple[str, int, int]:
    state = path.stat()
    return path.name, state.st_mtime_ns, state.st_size


def _read_index(folder: Path) -> dict[str, Any]:
    """What the last report was made from; nothing where there is none, or where the index is not one of ours."""
    try:
        index = json.loads((folder / _INDEX).read_text(encoding="utf-8"))
        inside = all(".." not in name and not name.startswith("/") for name in index["files"]) and index["files"]
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}
    return index if inside else {}


def gather(context: Context, methods: list[str] | None = None) -> tuple[Study, list[Path]]:
    """Everything that a report shows, and the files that it is from.

    Raises:
        DataError: there is no result that can be read.
    """
    from noiseid_cli.report import Study
    from noiseid_cli.storage.dataset_file import read_dataset
    from noiseid_cli.storage.provenance import provenance
    from noiseid_cli.storage.result_file import read_result

    units = estimate_units(context, methods)
    done = [unit for unit in units if unit.done]
    if not done:
        raise DataError(f"there are no results of this experiment under {context.folder}: run `noiseid estimate` first")
    warnings = _missing([unit.name for unit in units if not unit.done], len(units))
    results = _read([unit.path for unit in done], read_result, warnings)
    if not results:
        raise DataError("\n".join(warnings))
    # Points of a sweep share datasets and even results: what a file says of itself, it says of all of them.
    named = [named_at_point(results[unit.path], unit) for unit in done if unit.path in results]
    data_units = {unit.dataset.path: unit.dataset for unit in reversed(done) if unit.dataset.done}
    datasets = _read(list(dict.fromkeys(u.dataset.path for u in done if u.dataset.done)), read_dataset, warnings)
    published, estimates, claims = published_facts(context)
    section = context.experiment.estimate
    study = Study(
        title=context.experiment.report.title or context.experiment.experiment,
        experiment=context.experiment.experiment,
        results=named,
        model=model_facts(context),
        datasets=[
            replace(
                dataset_facts(context.at(data_units[path].point_index), fitted_part(section, dataset)),
                name=data_units[path].name,
            )
            for path, dataset in datasets.items()
        ],
        environment=provenance(),
        reproduce=_reproduce(context),
        warnings=warnings,
        citations=citations(context, methods),
        published=published,
        claims=claims,
        estimates=estimates,
        sweep=sweep_facts(context, done),
        bounds=bounds(context, done, results, datasets),
    )
    return study, [*results, *datasets]


def _read(paths: Sequence[Path], read: Callable[[Path], T], warnings: list[str]) -> dict[Path, T]:
    """Read files; one that is damaged becomes a warning, so that the others are not lost with it."""
    out = {}
    for path in paths:
        try:
            out[path] = read(path)
        except DataError as error:
            warnings.append(f"Left out: {error}")
    return out


def _missing(names: Sequence[str], total: int) -> list[str]:
    return [f"{len(names)} of {total} results are missing, the first is {names[0]}."] if names else []


def _reproduce(context: Context) -> list[str]:
    """The settings as they were, so that the page alone is enough to get the same numbers again."""
    settings = json.dumps(context.loaded.resolved(), indent=1)
    return ["Save these settings as experiment.yaml (JSON is YAML) and run `noiseid run experiment.yaml`:", settings]


def citations(context: Context, methods: list[str] | None = None) -> list[str]:
    """The works behind the methods and the model of an experiment.

    Args:
        context: the experiment.
        methods: as in ``estimate_units``.
    """
    from noiseid_cli.config.methods import METHOD_OPTIONS

    used = chosen_methods(context, methods).values() if context.experiment.estimate is not None else ()
    papers = [METHOD_OPTIONS[options.method].citation for options in used]
    return [paper for paper in dict.fromkeys([*papers, context.model.citation]) if paper]

"""`noiseid export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from noiseid_cli.commands.console import UNFINISHED, answer, complain, guarded
from noiseid_cli.commands.options import RUNS, ConfigOrResult, Flags, Method, Out, Seed, Set

_ALL = "yaml,json,mat,npz"


@guarded
def export(
    target: ConfigOrResult = None,
    to: Annotated[
        Path | None,
        typer.Option(
            "--to", metavar="FOLDER", help="Where to write. Default: export, beside the folder of the results."
        ),
    ] = None,
    formats: Annotated[str, typer.Option("--format", metavar="LIST", help="Formats, with commas between.")] = _ALL,
    method: Method = None,
    overrides: Set = None,
    seed: Seed = None,
    out: Out = RUNS,
) -> None:
    """Write Q, R, m0 and P0 for other programs.

    Of one result, or of all results of an experiment. As YAML, JSON, MAT and NumPy archive: with names, units, sample
    time, what is meant per sample, the model's parameters, and where it all came from.
    """
    from noiseid_cli.storage.atomic import publish
    from noiseid_cli.storage.export import read_exported
    from noiseid_cli.storage.export_formats import FORMATS

    wanted = _formats(formats, list(FORMATS))
    if target is not None and target.suffix == ".h5":
        _refuse_idle({"--method": method, "--set": overrides, "--seed": seed})
        files, folder, missing = [target], _beside(target), 0
    else:
        files, folder, missing = _results(target, out, overrides, seed, method)
    unfinished = []
    for file in files:
        data = read_exported(file)
        if data["status"] != "converged":
            unfinished.append(f"{data['result']} ({data['status']})")
        for name in wanted:
            path = (to or folder) / f"{file.stem}.{name}"
            publish(path, FORMATS[name](data))
            answer(str(path))
    if missing:
        complain(f"export: {missing} of {missing + len(files)} results are not there yet; `noiseid run` makes them")
    if unfinished:
        complain(f"export: {len(unfinished)} of {len(files)} results did not converge: first, {unfinished[0]}")
    if missing or unfinished:
        raise typer.Exit(UNFINISHED)


def _formats(text: str, known: list[str]) -> list[str]:
    from noiseid_cli.config.suggest import did_you_mean
    from noiseid_cli.errors import DataError

    wanted = [word.strip().lower() for word in text.split(",")]
    for word in wanted:
        if word not in known:
            raise DataError(f"--format {word!r}: known formats are {', '.join(known)}{did_you_mean(word, known)}")
    return list(dict.fromkeys(wanted))


def _refuse_idle(flags: dict[str, object]) -> None:
    from noiseid_cli.errors import DataError

    if given := [flag for flag, value in flags.items() if value is not None]:
        raise DataError(f"{given[0]} goes with an experiment; a result file is exported as it is")


def _beside(result: Path) -> Path:
    """The export folder of the experiment that a result lies in."""
    return (result.parent.parent if result.parent.name == "results" else result.parent) / "export"


def _results(
    config: Path | None, out: Path, overrides: list[str] | None, seed: int | None, method: list[str] | None
) -> tuple[list[Path], Path, int]:
    """Result files of an experiment that are there, the folder to write to, and how many are not there."""
    from noiseid_cli.commands.stages import open_job
    from noiseid_cli.errors import DataError
    from noiseid_cli.pipeline.units import estimate_units

    context = open_job(config, Flags(overrides, seed, out=out)).context
    units = estimate_units(context, method)
    done = [unit.path for unit in units if unit.done]
    if not done:
        raise DataError(f"{context.folder} holds no results of these settings: `noiseid run` makes them")
    return done, context.folder / "export", len(units) - len(done)

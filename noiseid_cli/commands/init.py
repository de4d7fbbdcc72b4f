"""`noiseid init`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from noiseid_cli.commands.console import answer, guarded, width
from noiseid_cli.commands.text import filled, table


@guarded
def init(
    path: Annotated[Path, typer.Argument(metavar="FILE", help="Where to write it.")] = Path("noiseid.yaml"),
    log: Annotated[
        Path | None,
        typer.Option("--from", metavar="LOG", help="A recording to look at: CSV, MAT, HDF5 or npz."),
    ] = None,
    model: Annotated[
        str,
        typer.Option(
            "--model",
            metavar="NAME",
            help="With --from: the model, by name or as FILE.py:CLASS. Default: a starter model is written too.",
            show_default=False,
        ),
    ] = "",
    time: Annotated[
        str, typer.Option("--time", metavar="COLUMN", help="With --from: the time column.", show_default=False)
    ] = "",
    interval: Annotated[
        float | None,
        typer.Option("--interval", metavar="S", help="With --from: seconds between rows, without a time column."),
    ] = None,
    inputs: Annotated[
        list[str] | None,
        typer.Option("--input", metavar="COLUMN", help="With --from: an input; with --model, NAME=COLUMN. Repeatable."),
    ] = None,
    outputs: Annotated[
        list[str] | None,
        typer.Option("--output", metavar="COLUMN", help="The same for an output."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", "-f", help="Replace files that are there.")] = False,
) -> None:
    """Write a commented starter experiment.

    It runs as it is: EM on a simulated flexible robot. Its comments say what can be changed, and how to take
    recordings and a model of your own.

    With --from LOG it is made for that recording: the time column and its unit, inputs and outputs, what is wrong
    with the log and what to do about it, and start values for Q and R are found out, each with its reason.
    """
    from noiseid_cli.errors import DataError
    from noiseid_cli.storage.atomic import publish

    if path.is_dir():
        path = path / "noiseid.yaml"
    if log is None:
        idle = {"--model": model, "--time": time, "--interval": interval, "--input": inputs, "--output": outputs}
        if given := [flag for flag, value in idle.items() if value]:
            raise DataError(f"{given[0]} goes with --from LOG: it says how that recording is to be read")
        files = {path: Path(__file__).with_name("starter.yaml").read_text(encoding="utf-8")}
    else:
        files = _made_for(log, path, model, time, interval, inputs, outputs)
    if there := [file for file in files if file.exists() and not force]:
        raise DataError(f"{there[0]} is there already: give another name, or --force to replace it")
    for file, text in files.items():
        publish(file, text.encode())
        answer(f"wrote {file}")
    name = "" if path == Path("noiseid.yaml") else f" {path}"
    answer(f"  noiseid check{name}   finds every mistake in it")
    answer(f"  noiseid run{name}     runs it")


def _made_for(
    log: Path,
    path: Path,
    model: str,
    time: str,
    interval: float | None,
    inputs: list[str] | None,
    outputs: list[str] | None,
) -> dict[Path, str]:
    """The files for a log, by name; tells what was seen in it."""
    from noiseid_cli.errors import DataError
    from noiseid_cli.pipeline.starter import MODEL_FILE, Wishes, plan_starter
    from noiseid_cli.pipeline.starter_config import config_text
    from noiseid_cli.pipeline.starter_model import model_text

    if time and interval is not None:
        raise DataError("give either --time or --interval")
    if interval is not None and not 0.0 < interval < float("inf"):
        raise DataError(f"--interval {interval:g}: it must be a number of seconds above 0")
    plan = plan_starter(log, path, Wishes(model, time, interval, tuple(inputs or ()), tuple(outputs or ())))
    names = {key: name for group in (plan.inputs, plan.outputs) for name, key in group.items()}
    answer(f"{log}: {len(plan.found.table.row_numbers)} rows, {plan.time.interval:.6g} s apart")
    rows = [] if plan.time.key is None else [(str(plan.time.key), "time", plan.time.why)]
    for role in plan.roles:
        if role.key in names:
            word = "input" if role.key in plan.inputs.values() else "output"
            why = role.why if role.role == word else "as asked for" if plan.model is None else "matched with the model"
            rows.append((str(role.key), f"{word} {names[role.key]}", why))
        else:
            rows.append((str(role.key), "left out", role.why if role.role == "left out" else "not asked for"))
    for line in table(("column", "taken as", "why"), rows, width()):
        answer(line)
    for proposal in plan.proposals:
        answer(filled(f"{proposal.problem}: {proposal.choice}: {proposal.why}", width(), "  ", "    "))
    files = {path: config_text(plan)}
    return files if plan.model is not None else {path.parent / MODEL_FILE: model_text(plan)} | files

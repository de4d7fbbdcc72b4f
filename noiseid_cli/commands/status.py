"""`noiseid status`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from noiseid_cli.commands.console import UNFINISHED, answer, answer_json, guarded, width
from noiseid_cli.commands.options import RUNS, Config, Flags, Json, Method, Out, Seed, Set
from noiseid_cli.commands.text import wrapped
from noiseid_cli.pipeline.wording import counted

if TYPE_CHECKING:
    from noiseid_cli.pipeline.context import Context
    from noiseid_cli.pipeline.status import ExperimentStatus, UnitStatus


@guarded
def status(
    config: Config = None,
    method: Method = None,
    overrides: Set = None,
    seed: Seed = None,
    out: Out = RUNS,
    json: Json = False,
) -> None:
    """Show which units are done, failed or missing, and why.

    Only looks: it may be called while a run is at work. `noiseid run` makes what is missing and tries again what
    failed; `--force` does again what did not converge. Leaves with 4 if a unit failed or did not converge.
    """
    from noiseid_cli.commands.stages import open_job
    from noiseid_cli.pipeline.status import experiment_status

    context = open_job(config, Flags(overrides, seed, out=out, quiet=json)).context
    found = experiment_status(context, method)
    if json:
        answer_json(_as_data(context, found))
    else:
        _answer(context, found)
    if found.astray:
        raise typer.Exit(UNFINISHED)


def _answer(context: Context, found: ExperimentStatus) -> None:
    from noiseid_cli.report.render_terminal import terminal_text

    for stage, words in found.counts().items():
        total = sum(words.values())
        parts = ", ".join(f"{number} {word.replace('_', ' ')}" for word, number in words.items())
        answer(f"{stage}: {counted(total, 'unit')}: {parts}")
    groups: dict[tuple[str, str], list[UnitStatus]] = {}
    for unit in found.astray:
        groups.setdefault((unit.word, unit.reason), []).append(unit)
    for (word, reason), units in groups.items():
        names = units[0].unit if len(units) == 1 else f"{units[0].unit} and {len(units) - 1} more"
        tries = f" after {counted(units[0].tries, 'try', 'tries')}" if units[0].tries > 1 else ""
        answer(wrapped(terminal_text(f"  {names}: {word.replace('_', ' ')}{tries}: {reason}"), width()))
    if found.holder:
        answer(f"at work in {context.folder}: {found.holder}")


def _as_data(context: Context, found: ExperimentStatus) -> dict[str, object]:
    return {
        "experiment": context.experiment.experiment,
        "folder": str(context.folder),
        "at_work": found.holder or None,
        "counts": found.counts(),
        "units": [
            {
                "unit": unit.unit,
                "stage": unit.stage,
                "condition": unit.condition,
                "status": unit.status or None,
                "reason": unit.reason or None,
                "tries": unit.tries,
                "file": str(unit.path),
            }
            for unit in found.units
        ],
    }

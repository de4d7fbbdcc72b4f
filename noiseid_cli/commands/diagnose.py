"""`noiseid diagnose`."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from noiseid_cli.commands.console import answer, answer_json, guarded, width
from noiseid_cli.commands.options import RUNS, ConfigOrResult, Flags, Json, Method, Out, Quiet, Seed, Set


class At(StrEnum):
    """Whose noise values the filter has."""

    tuning = "tuning"
    start = "start"
    estimate = "estimate"
    truth = "truth"


@guarded
def diagnose(
    what: ConfigOrResult = None,
    at: Annotated[
        At | None, typer.Option("--at", help="Whose noise values to look at closely. Default: the estimate.")
    ] = None,
    method: Method = None,
    overrides: Set = None,
    seed: Seed = None,
    out: Out = RUNS,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Say whether a filter agrees with its data, and where it does not.

    NIS with its bounds, NEES where the truth is known, whiteness and distribution of the innovations, held-out data,
    and the states and inputs that the misfit follows. Before any estimate it takes the experiment's start and tuning.
    """
    from noiseid_cli.commands.text import filled
    from noiseid_cli.pipeline.diagnosing import diagnose_experiment, diagnose_result
    from noiseid_cli.report.render_terminal import terminal_table

    place = None if at is None else at.value
    if what is not None and what.suffix == ".h5":
        found = diagnose_result(what, place)
    else:
        from noiseid_cli.commands.stages import open_job

        job = open_job(what, Flags(overrides, seed, out=out, quiet=quiet, json=json))
        found = diagnose_experiment(job.context, method, place)
    if json:
        answer_json(
            {
                "at": found.at,
                "tables": [table.as_data() for table in found.tables],
                "findings": [{"unit": name, "sentences": sentences} for name, sentences in found.sentences],
            }
        )
        return
    for table in found.tables:
        answer(terminal_table(table, width()))
    for name, sentences in found.sentences:
        answer(f"{name}, filter at the {found.at} values:")
        for sentence in sentences:
            answer(filled(sentence, width(), "- ", "  "))

"""What the commands that run stages have in common: open the experiment, run units, say how it ended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from noiseid_cli.commands.console import UNFINISHED, answer, answer_json, say, width
from noiseid_cli.commands.progress import QuietListener, listener

if TYPE_CHECKING:
    from noiseid_cli.pipeline.context import Context
    from noiseid_cli.pipeline.engine import Recipe, Token, Unit


@dataclass
class Session:
    """One command at work on one experiment."""

    context: Context
    recipe: Recipe
    listener: QuietListener
    jobs: int
    force: bool
    dry_run: bool
    json: bool

    def run(self, stage: str, units: Sequence[Unit]) -> list[Token]:
        """Make what is missing; with --dry-run, say what that would be.

        Raises:
            typer.Exit: with 3 if a unit failed for a reason that the user must mend.
        """
        from noiseid_cli.pipeline.engine import Token, run_units

        if self.dry_run:
            todo = [u for u in units if self.force or not u.done]
            answer(f"{stage}: {len(todo)} of {len(units)} units to do")
            for unit in todo:
                answer(f"  {unit.name} -> {unit.path}")
            return [Token(u.name, u.path, "there" if u.done else "missing") for u in units]
        with self.listener:
            tokens = run_units(self.context, self.recipe, stage, units, self.listener, self.jobs, self.force)
        failed = [t for t in tokens if t.state == "failed"]
        if failed:
            say(f"noiseid: {stage}: {len(failed)} of {len(tokens)} units failed: {failed[0].unit}: {failed[0].message}")
            raise typer.Exit(3)
        return tokens

    def finish(self, tokens: Sequence[Token], what: str) -> None:
        """Name the files on stdout, and leave with 4 if an estimate did not converge."""
        if self.dry_run:
            return
        if self.json:
            answer_json(
                [
                    {
                        "unit": t.unit,
                        "file": str(t.path),
                        "state": t.state,
                        "converged": t.converged,
                        "result": t.message,
                    }
                    for t in tokens
                ]
            )
        else:
            made = sum(t.state == "made" for t in tokens)
            answer(f"{len(tokens)} {what}, {made} made now:" if made else f"nothing to do: {len(tokens)} {what} there:")
            for token in tokens:
                answer(f"  {token.path}")
        unfinished = [t for t in tokens if not t.converged]
        if unfinished:
            say(f"noiseid: {len(unfinished)} of {len(tokens)} did not converge: {unfinished[0].unit}")
            raise typer.Exit(UNFINISHED)


def open_session(
    config: Path | None,
    out: Path,
    overrides: list[str] | None,
    seed: int | None,
    *,
    jobs: int = 1,
    force: bool = False,
    dry_run: bool = False,
    quiet: bool = False,
    verbose: bool = False,
    json: bool = False,
) -> Session:
    """Find and open the experiment, and say which one was taken."""
    from noiseid_cli.config.load import find_experiment
    from noiseid_cli.pipeline.context import open_experiment
    from noiseid_cli.pipeline.engine import Recipe

    found = find_experiment(config)
    if not quiet:
        say(found.sentence)
    heard = listener(quiet, verbose)
    context = open_experiment(found.file, out, overrides or (), seed, heard.say)
    recipe = Recipe(found.file, out, tuple(overrides or ()), seed)
    return Session(context, recipe, heard, jobs, force, dry_run, json)


def show_report(session: Session, methods: list[str] | None) -> None:
    """Write the report, print its main tables, and leave with 4 if an estimate did not converge."""
    from noiseid_cli.pipeline.reporting import make_report_stage
    from noiseid_cli.report.render_terminal import terminal_table

    reported = make_report_stage(session.context, methods)
    if session.json:
        answer_json({"folder": str(reported.files.folder), "tables": [t.as_data() for t in reported.tables]})
    else:
        for table in reported.tables:
            answer(terminal_table(table, width()))
        page = reported.files.html or reported.files.markdown or reported.files.folder
        answer(f"report: {page}")
    if reported.unfinished:
        say(f"noiseid: {reported.unfinished} results did not converge; the report names them")
        raise typer.Exit(UNFINISHED)

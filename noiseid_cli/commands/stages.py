"""What the commands that run stages have in common: open the experiment, run units, say how it ended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from noiseid_cli.commands.console import FAULTY, UNFINISHED, answer, answer_json, complain, width
from noiseid_cli.commands.options import Flags
from noiseid_cli.commands.progress import QuietListener, listener
from noiseid_cli.errors import DataError
from noiseid_cli.pipeline.wording import counted

if TYPE_CHECKING:
    from noiseid_cli.pipeline.context import Context
    from noiseid_cli.pipeline.making import Token, Unit
    from noiseid_cli.pipeline.reporting import Reported

_MAKES = {"simulate": "dataset", "import": "dataset", "estimate": "result"}


@dataclass
class Job:
    """One command at work on one experiment.

    Attributes:
        context: the experiment.
        listener: is told what goes on.
        flags: of the command.
        stages: what came of the units of each stage that has run.
        waiting: number of units that could not run for want of their dataset.
    """

    context: Context
    listener: QuietListener
    flags: Flags
    stages: dict[str, list[Token]] = field(default_factory=dict)
    waiting: int = 0

    def run(self, stage: str, units: Sequence[Unit]) -> None:
        """Make what is missing; with --dry-run, find out what that would be.

        Raises:
            typer.Exit: with 3 if every unit failed: there is nothing to go on with.
        """
        from noiseid_cli.pipeline.engine import run_units
        from noiseid_cli.pipeline.making import Token

        flags = self.flags
        if flags.dry_run:
            self.stages[stage] = [
                Token(u.name, u.path, "there" if u.done and not flags.force else "to do") for u in units
            ]
            return
        with self.listener:
            tokens = run_units(
                self.context, stage, units, self.listener, flags.jobs, flags.force, flags.wait, flags.dask,
                flags.time_limit,
            )  # fmt: skip
        self.stages[stage] = tokens
        failed = sum(token.state == "failed" for token in tokens)
        if failed and len(tokens) > 1:
            complain(f"{stage}: {failed} of {len(tokens)} units failed")
        if failed and failed == len(tokens):
            raise typer.Exit(FAULTY)

    def make_data(self, stage: str) -> None:
        """Simulate or import the datasets.

        Raises:
            DataError: the experiment gets its data the other way.
        """
        from noiseid_cli.pipeline.units import data_stage, dataset_units

        other = data_stage(self.context)
        if other != stage:
            instead = {"simulate": "simulates its data", "import": "imports recordings"}[other]
            raise DataError(f"the experiment has no `{stage}` section, it {instead}: run `noiseid {other}`")
        self.run(stage, dataset_units(self.context))

    def estimate(self, methods: list[str] | None) -> None:
        """Run the methods on the datasets that are there.

        Raises:
            DataError: there are none.
        """
        from noiseid_cli.pipeline.units import data_stage, estimate_units, waiting_units

        units = estimate_units(self.context, methods)
        if not self.flags.dry_run:
            waiting = waiting_units(self.context, units, self.flags.force)
            self.waiting = len(waiting)
            stage = data_stage(self.context)
            if waiting and stage not in self.stages:
                them = f"{counted(len(waiting), 'unit')} without a dataset, first {waiting[0].name}"
                complain(f"estimate: {them}: `noiseid {stage}` makes what is missing")
            left_out = {unit.name for unit in waiting}
            units = [unit for unit in units if unit.name not in left_out]
        self.run("estimate", units)

    def report(self, methods: list[str] | None, anew: bool = False) -> Reported:
        """Write the report; without ``anew`` only if something has changed."""
        from noiseid_cli.pipeline.reporting import make_report_stage

        with self.listener:
            return make_report_stage(self.context, methods, anew)

    def finish(self, reported: Reported | None = None) -> None:
        """Print the answer, and leave with 4 if a unit failed or an estimate did not converge."""
        if self.flags.json:
            answer_json(self._as_data(reported))
        else:
            self._answer(reported)
        for stage, tokens in self.stages.items():
            astray = [token for token in tokens if token.unfinished]
            if astray:
                which = f"{astray[0].unit} ({astray[0].status})"
                complain(f"{stage}: {len(astray)} of {counted(len(tokens), 'unit')} did not converge: first, {which}")
        if reported is not None:
            for warning in reported.warnings:
                complain(f"report: {warning}")
            if reported.unfinished and "estimate" not in self.stages:
                complain(f"report: {counted(reported.unfinished, 'result')} did not converge; the report names them")
        tokens = [token for stage in self.stages.values() for token in stage]
        faulty = any(token.unfinished or token.state == "failed" for token in tokens)
        if faulty or self.waiting or (reported and (reported.warnings or reported.unfinished)):
            raise typer.Exit(UNFINISHED)

    def _answer(self, reported: Reported | None) -> None:
        page = reported.page if reported else None
        if reported is not None:
            from noiseid_cli.report.render_terminal import terminal_table

            for table in reported.tables:
                answer(terminal_table(table, width()))
        if page is not None:
            answer(f"report: {page}")
            return
        for stage, tokens in self.stages.items():
            self._answer_stage(stage, [token for token in tokens if token.state != "failed"])

    def _answer_stage(self, stage: str, tokens: list[Token]) -> None:
        """The files of a stage: what there is, or what would be made."""
        files = counted(len(tokens), _MAKES[stage])
        new = [token for token in tokens if token.state != "there"]
        some = files if len(new) == len(tokens) else f"{len(new)} of {files}"
        if not new:
            answer(f"{stage}: nothing to do, {files} there" + ("" if self.flags.dry_run else ":"))
        else:
            answer(f"{stage}: {some} {'to do' if self.flags.dry_run else 'made now'}:")
        for token in new if self.flags.dry_run else tokens:
            answer(f"  {token.path}")

    def _as_data(self, reported: Reported | None) -> dict[str, Any]:
        data: dict[str, Any] = {
            f"{_MAKES[stage]}s": [
                {
                    "unit": token.unit,
                    "file": str(token.path),
                    "state": token.state,
                    "status": token.status or None,
                    "message": token.message,
                }
                for token in tokens
            ]
            for stage, tokens in self.stages.items()
        }
        if reported is not None:
            data["report"] = None if reported.page is None else str(reported.page)
            data["warnings"] = reported.warnings
            data["tables"] = [table.as_data() for table in reported.tables]
        return data


def open_job(config: Path | None, flags: Flags) -> Job:
    """Find and open the experiment, and say which one was taken."""
    from noiseid_cli.config.load import find_experiment
    from noiseid_cli.pipeline.cluster import check_address
    from noiseid_cli.pipeline.context import open_experiment

    if flags.dask:
        check_address(flags.dask)  # a wrong one is told before anything is made
    found = find_experiment(config)
    heard = listener(flags.quiet, flags.verbose)
    heard.say(found.sentence)
    context = open_experiment(found.file, flags.out, flags.overrides or (), flags.seed, heard.say)
    return Job(context, heard, flags)

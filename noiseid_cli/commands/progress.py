"""Progress on stderr: one live display on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Self

from noiseid_cli.commands.console import say

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from noiseid_cli.pipeline.engine import Token


class QuietListener:
    """Says nothing but what failed."""

    def __enter__(self) -> Self:
        """Nothing to prepare."""
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing to tidy up."""

    def stage(self, name: str, total: int, there: int) -> None:
        """A stage begins."""

    def begin(self, unit: str) -> None:
        """A unit begins."""

    def passed(self, unit: str, passes: int, loglik: float) -> None:
        """A unit passed over its data."""

    def end(self, token: Token) -> None:
        """A unit ended."""
        if token.state == "failed":
            say(f"{token.unit}: {token.message}")

    def say(self, sentence: str) -> None:
        """Not said."""


class PlainListener(QuietListener):
    """A line when a stage begins and when a unit ends; with ``verbose``, one per pass."""

    def __init__(self, verbose: bool = False) -> None:
        """Say more with ``verbose``."""
        self.verbose = verbose

    def stage(self, name: str, total: int, there: int) -> None:
        """A stage begins."""
        already = f", {there} there already" if there else ""
        self.say(f"{name}: {total} unit{'s' * (total != 1)}{already}")

    def passed(self, unit: str, passes: int, loglik: float) -> None:
        """A unit passed over its data."""
        if self.verbose:
            self.say(f"  {unit}: pass {passes}, log-likelihood {loglik:.4f}")

    def end(self, token: Token) -> None:
        """A unit ended."""
        self.say(f"  {token.unit}: {token.message} ({token.seconds:.1f} s)")
        if self.verbose and token.state == "made":
            self.say(f"    {token.path}")

    def say(self, sentence: str) -> None:
        """Print a sentence."""
        say(sentence)


class LiveListener(PlainListener):
    """One display: a bar per stage with its rate and the time left, a line per unit at work."""

    def __init__(self, verbose: bool = False) -> None:
        """Prepare the display; it shows with the ``with`` statement."""
        super().__init__(verbose)
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        self.progress: Progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=20),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[note]}"),
            console=Console(stderr=True, highlight=False),
            transient=True,
        )
        self.bar: TaskID | None = None
        self.at_work: dict[str, tuple[TaskID, float]] = {}

    def __enter__(self) -> Self:
        """Show the display."""
        self.progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Take the display away."""
        self.progress.stop()

    def stage(self, name: str, total: int, there: int) -> None:
        """A stage begins."""
        super().stage(name, total, there)
        if self.bar is not None:
            self.progress.remove_task(self.bar)
        self.bar = self.progress.add_task(name, total=total, completed=there, note="")

    def begin(self, unit: str) -> None:
        """A unit begins."""
        task = self.progress.add_task(f"  {unit}", total=None, note="")
        self.at_work[unit] = task, time.monotonic()

    def passed(self, unit: str, passes: int, loglik: float) -> None:
        """A unit passed over its data."""
        super().passed(unit, passes, loglik)
        if unit in self.at_work:
            self.progress.update(self.at_work[unit][0], completed=passes, note=f"log-likelihood {loglik:.3f}")

    def end(self, token: Token) -> None:
        """A unit ended."""
        super().end(token)
        if token.unit in self.at_work:
            self.progress.remove_task(self.at_work.pop(token.unit)[0])
        if self.bar is not None:
            self.progress.advance(self.bar)

    def say(self, sentence: str) -> None:
        """Print a sentence above the display."""
        self.progress.console.print(sentence, markup=False, soft_wrap=True)


def listener(quiet: bool, verbose: bool) -> QuietListener:
    """The one that fits the flags and the terminal."""
    if quiet:
        return QuietListener()
    return LiveListener(verbose) if sys.stderr.isatty() else PlainListener(verbose)

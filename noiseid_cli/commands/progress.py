"""Progress on stderr: one live display on a terminal, plain lines elsewhere."""

from __future__ import annotations

import os
import sys
import time
from typing import TYPE_CHECKING, Self

from noiseid_cli.commands.console import complain, say, width
from noiseid_cli.commands.pace import Pace
from noiseid_cli.commands.text import wrapped
from noiseid_cli.pipeline.making import Listener, Token
from noiseid_cli.pipeline.wording import counted

if TYPE_CHECKING:
    from rich.console import RenderableType


class QuietListener(Listener):
    """Says nothing but what failed."""

    def __init__(self) -> None:
        """Nothing was heard yet."""
        self._reasons: dict[str, str] = {}

    def __enter__(self) -> Self:
        """Nothing to prepare."""
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing to tidy up."""

    def end(self, token: Token) -> None:
        """A unit ended; a reason that many of them fail for is given once."""
        if token.state == "failed":
            first = self._reasons.setdefault(token.message, token.unit)
            reason = token.message if first == token.unit else f"for the same reason as {first}"
            self.fault(f"{token.unit} failed: {reason}")

    def fault(self, text: str) -> None:
        """Print what went wrong."""
        complain(text)


class PlainListener(QuietListener):
    """A line when a stage begins, when a unit ends, and now and then how far it is; with ``verbose``, one per pass."""

    tells_pace = True

    def __init__(self, verbose: bool = False) -> None:
        """Say more with ``verbose``."""
        super().__init__()
        self._verbose = verbose
        self._said: set[str] = set()
        self._pace = Pace("", 0, 0)

    def stage(self, name: str, total: int, there: int) -> None:
        """A stage begins."""
        self._pace = Pace(name, total, there)
        already = f", {there if there < total else 'all'} there already" if there else ""
        self.line(f"{name}: {counted(total, 'unit')}{already}")

    def compiling(self, unit: str, count: int, kernel: str) -> None:
        """A unit waits for a kernel."""
        if self._verbose:
            self.line(f"  {unit}: compiling kernel {count}, {kernel}")

    def passed(self, unit: str, passes: int, loglik: float) -> None:
        """A unit passed over its data."""
        if self._verbose:
            self.line(f"  {unit}: pass {passes}, log-likelihood {loglik:.4f}")

    def end(self, token: Token) -> None:
        """A unit ended."""
        super().end(token)
        if token.state == "made":
            self.line(f"  {token.unit}: {token.message}, {token.seconds:.1f} s")
            if self._verbose:
                self.line(f"    {token.path}")
        self._pace.count(token)
        if self.tells_pace and (sentence := self._pace.sentence()):
            self.line(sentence)

    def say(self, sentence: str) -> None:
        """Print a sentence, once."""
        if sentence not in self._said:
            self._said.add(sentence)
            self.line(sentence)

    def line(self, text: str) -> None:
        """Print a line."""
        say(text)


class LiveListener(PlainListener):
    """Below the lines, one display: a bar for the stage with rate and time left, and a row for each unit at work."""

    tells_pace = False

    def __init__(self, verbose: bool = False) -> None:
        """Prepare the display; it shows with the ``with`` statement."""
        super().__init__(verbose)
        from rich.console import Console
        from rich.live import Live
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
        from rich.progress import TimeRemainingColumn as LeftColumn

        console = Console(stderr=True, highlight=False, markup=False)
        self._bar = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(24),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}", markup=False),
            TimeElapsedColumn(),
            TextColumn("left", markup=False),
            LeftColumn(compact=True),
            console=console,
        )
        self._at_work: dict[str, tuple[float, str, str]] = {}  # when it began, and the last that was heard of it
        self._live = Live(console=console, get_renderable=self._picture, transient=True, refresh_per_second=8)

    def __enter__(self) -> Self:
        """Show the display."""
        self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Take the display away."""
        self._live.stop()
        self._clear()

    def stage(self, name: str, total: int, there: int) -> None:
        """A stage begins."""
        super().stage(name, total, there)
        self._clear()
        self._bar.add_task(name, total=total, completed=there, visible=there < total, rate="")

    def begin(self, unit: str) -> None:
        """A unit begins."""
        self._at_work[unit] = time.monotonic(), "", ""

    def compiling(self, unit: str, count: int, kernel: str) -> None:
        """A unit waits for a kernel."""
        super().compiling(unit, count, kernel)
        self._note(unit, f"compiling kernel {count}", kernel)

    def passed(self, unit: str, passes: int, loglik: float) -> None:
        """A unit passed over its data."""
        super().passed(unit, passes, loglik)
        self._note(unit, f"pass {passes}", f"log-likelihood {loglik:.2f}")

    def _note(self, unit: str, what: str, more: str) -> None:
        if unit in self._at_work:
            self._at_work[unit] = self._at_work[unit][0], what, more

    def end(self, token: Token) -> None:
        """A unit ended."""
        self._at_work.pop(token.unit, None)
        super().end(token)
        for task in self._bar.task_ids:
            self._bar.update(task, advance=1, rate=self._pace.rate())

    def fault(self, text: str) -> None:
        """Print what went wrong above the display."""
        self.line(f"noiseid: {text}")

    def line(self, text: str) -> None:
        """Print a line above the display."""
        self._live.console.print(wrapped(text, width(sys.stderr)), soft_wrap=True)

    def _clear(self) -> None:
        self._at_work.clear()
        for task in self._bar.task_ids:
            self._bar.remove_task(task)

    def _picture(self) -> RenderableType:
        """The bar, and below it what is at work."""
        from rich.console import Group
        from rich.table import Table

        rows = Table.grid(padding=(0, 2, 0, 0))
        rows.add_column(no_wrap=True, overflow="ellipsis")
        for _ in range(3):
            rows.add_column(no_wrap=True, justify="right")
        for unit, (began, *heard) in list(self._at_work.items()):
            rows.add_row(f"  {unit}", *heard, f"{time.monotonic() - began:.0f} s")
        return Group(self._bar.get_renderable(), rows)


def listener(quiet: bool, verbose: bool) -> QuietListener:
    """The one that fits the flags and the terminal."""
    if quiet:
        return QuietListener()
    live = sys.stderr.isatty() and os.environ.get("TERM", "dumb") != "dumb"
    return LiveListener(verbose) if live else PlainListener(verbose)

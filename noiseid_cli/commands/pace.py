"""How fast the units of a stage end, and how long the others will take."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from noiseid_cli.pipeline.making import Token


class Pace:
    """How fast the units of a stage end, and how long the others will take."""

    INTERVAL = 10.0
    """Seconds between two sentences."""

    def __init__(self, stage: str, total: int, there: int, clock: Callable[[], float] = time.monotonic) -> None:
        """A stage begins."""
        self._stage, self._total, self._clock = stage, total, clock
        self._there, self._made, self._failed = there, 0, 0
        self._began = self._said = clock()

    def count(self, token: Token) -> None:
        """A unit ended."""
        self._made += token.state == "made"
        self._failed += token.state == "failed"

    def rate(self) -> str:
        """Units per second, minute or hour; empty before the first has ended."""
        ended, seconds = self._made + self._failed, self._clock() - self._began
        if not ended or seconds <= 0.0:
            return ""
        per = ended / seconds
        for factor, unit in ((1, "s"), (60, "min"), (3600, "h")):
            if per * factor >= 1 or unit == "h":
                return f"{per * factor:.3g}/{unit}"
        return ""

    def sentence(self) -> str:
        """How far the stage is; empty where that was said a moment ago, or where it is at its end."""
        now, ended = self._clock(), self._made + self._failed
        left = self._total - self._there - ended
        if now - self._said < self.INTERVAL or not ended or left <= 0:
            return ""
        self._said = now
        failed = f", {self._failed} failed" if self._failed else ""
        duration = in_words(left * (now - self._began) / ended)
        done = self._there + self._made
        return f"{self._stage}: {done} of {self._total} done{failed}, {self.rate()}, about {duration} left"


def in_words(seconds: float) -> str:
    """A duration such as ``40 s``, ``3 min`` or ``2.5 h``."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"

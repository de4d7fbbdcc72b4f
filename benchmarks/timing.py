"""How everything here is timed: side by side, warmed up, by the best of many runs; and how it is printed."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

Work = Callable[[], object]
AGREE = 1e-6
TURN = 0.05  # s


def side_by_side(works: dict[str, Work | str], runs: int = 25, budget: float = 10.0) -> dict[str, float | str]:
    """Least time of each, s: what it takes where nothing else disturbs.

    Of wall-clock and processor time the smaller one counts: the first is longer where others have the core, the second
    where several threads are at work.

    The works take turns, so that whatever else the machine does falls on all alike. A first call of each, which may
    compile, is not counted. A quick one is called again and again while its turn lasts: after another's turn it finds
    the processor's caches cold. A slow one has fewer turns, once it has used its budget.

    Args:
        works: by name what is timed, or a sentence on why it is not, which is handed through.
        runs: turns of each.
        budget: seconds after which a work has no further turn; it has three at least.
    """
    times: dict[str, list[float]] = {}
    for name, work in works.items():
        if not isinstance(work, str):
            work()
            times[name] = []
    for turn in range(runs):
        for name, spent in times.items():
            if turn >= 3 and sum(spent) > budget:
                continue
            end, least = time.perf_counter() + TURN, math.inf
            while least == math.inf or time.perf_counter() < end:
                began, busy = time.perf_counter(), time.process_time()
                works[name]()  # type: ignore[operator]
                least = min(least, time.perf_counter() - began, time.process_time() - busy)
            spent.append(least)
    return {name: work if isinstance(work, str) else min(times[name]) for name, work in works.items()}


def peer(make: Callable[[], Work | str]) -> Work | str:
    """What a peer does, or why it cannot be timed here."""
    try:
        return make()
    except ImportError as error:
        return f"not installed ({error.name})"


def checked(work: Work, off: float) -> Work | str:
    """The work, or a sentence where its answer is further off than rounding explains; ``off`` is relative."""
    return work if off <= AGREE else f"computes something else: {off:.1g} off"


def seconds(value: float | str) -> str:
    """A time with three digits and its unit; a sentence as it is."""
    if isinstance(value, str):
        return value
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if value >= size or unit == "us":
            return f"{value / size:#.3g}".rstrip(".") + f" {unit}"
    raise AssertionError


def ratio(value: float | str, ours: float | str) -> str:
    """How many times as long as ours."""
    if isinstance(value, str) or isinstance(ours, str):
        return ""
    return f"{value / ours:#.2g}".rstrip(".") if value < 10 * ours else f"{value / ours:.0f}"


def compared(label: str, times: dict[str, float | str]) -> list[list[str]]:
    """Rows of one comparison; the first entry is ours."""
    ours = next(iter(times.values()))
    return [
        [label if i == 0 else "", name, seconds(t), "" if i == 0 else ratio(t, ours)]
        for i, (name, t) in enumerate(times.items())
    ]


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]], right: int) -> str:
    """A Markdown table; the columns from ``right`` on are set to the right."""
    lines = [head, ["---" if i < right else "---:" for i in range(len(head))], *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)

"""The guess at what was meant."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def did_you_mean(word: object, known: Iterable[str]) -> str:
    """Give ``; did you mean x?`` for the nearest known word, or nothing where none is near."""
    by_case = {name.casefold(): name for name in known}
    near = difflib.get_close_matches(str(word)[:100].casefold(), by_case, n=1, cutoff=0.6)
    return f"; did you mean {by_case[near[0]]}?" if near else ""


_ONE = {
    "entries": "entry",
    "numbers": "number",
    "states": "state",
    "inputs": "input",
    "noises": "noise",
    "outputs": "output",
}


def counted(count: int, things: str) -> str:
    """A number with its noun, given in the plural: ``1 process noise``, ``2 outputs``."""
    words = [_ONE.get(word, word) if count == 1 else word for word in things.split()]
    return f"{count} {' '.join(words)}"

"""The guess at what was meant."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def did_you_mean(word: object, known: Iterable[str]) -> str:
    """Give ``; did you mean x?`` for the nearest known word, or nothing where none is near."""
    by_case = {name.casefold(): name for name in known}
    near = difflib.get_close_matches(str(word)[:100].casefold(), by_case, n=1, cutoff=0.6)
    return f"; did you mean {by_case[near[0]]}?" if near else ""

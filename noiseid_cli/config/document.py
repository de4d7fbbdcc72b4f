"""A text that was read, with the place of each of its settings, so that every complaint can point at one."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from noiseid_cli.errors import Problem

Path = tuple[str | int, ...]
"""Keys and list indices (from 0) that lead from the root to a setting."""

_LINE_BREAK = re.compile("\r\n|[\n\r\x85\u2028\u2029]")
_LONGEST_EXCERPT = 160


class Place(NamedTuple):
    """Line and column, both from 1, of a key (or list entry) and of its value."""

    key: tuple[int, int]
    value: tuple[int, int]


class Fault:
    """Stands in the data where a value could not be read; the complaint about it is already made."""


@dataclass
class Document:
    """The content of a YAML text.

    Attributes:
        file: name of the file, as shown to the user.
        text: the text itself.
        data: nested dicts, lists and scalars; ``Fault()`` where a value could not be read.
        places: place of each setting in the text.
        sources: settings that do not come from the text, with what set them (such as ``--set seed=3``).
        problems: what is wrong with the text itself, in the order of the text.
    """

    file: str
    text: str
    data: Any = None
    places: dict[Path, Place] = field(default_factory=dict)
    sources: dict[Path, str] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Split the text as YAML counts its lines."""
        self._lines = _LINE_BREAK.split(self.text)

    def problem(self, path: Path, message: str, *, at_key: bool = False) -> Problem:
        """Complain about a setting, at its value (or its key), or at the nearest setting around it that is there.

        Args:
            path: the setting; it may be one that is missing.
            message: what is wrong and what is allowed.
            at_key: point at the key and not at the value.
        """
        for length in range(len(path), -1, -1):
            around = path[:length]
            if around in self.sources:
                return Problem(1, 1, dotted(path), message, source=self.sources[around])
            if around in self.places:
                place = self.places[around]
                at = place.key if at_key or length < len(path) else place.value
                return self.problem_at(at[0], at[1], message, path)
        return self.problem_at(1, 1, message, path)

    def problem_at(self, line: int, column: int, message: str, path: Path = ()) -> Problem:
        """Complain about a place in the text."""
        return Problem(line, column, dotted(path), message, self._excerpt(line, column))

    def _excerpt(self, line: int, column: int) -> str:
        """Give the line in printable characters, one for one; nothing where the place lies far to the right."""
        if line > len(self._lines) or column > _LONGEST_EXCERPT:
            return ""
        text = self._lines[line - 1]
        shown = "".join(c if c.isprintable() else " " if c == "\t" else "\N{REPLACEMENT CHARACTER}" for c in text)
        return shown if len(shown) <= _LONGEST_EXCERPT else shown[:_LONGEST_EXCERPT] + " ..."


def dotted(path: Path) -> str:
    """Write a path as ``--set`` takes it: ``simulate.process_noise.std.0``; a key that holds a dot in quotes."""
    return ".".join(f'"{p}"' if isinstance(p, str) and not re.fullmatch(r"[^.\"=\s]+", p) else str(p) for p in path)


def value_at(data: Any, path: Path) -> Any:
    """Give the value at a path, None where there is none."""
    for step in path:
        try:
            data = data[step]
        except (KeyError, IndexError, TypeError):
            return None
    return data

"""Plain text for a terminal: wrapped paragraphs, tables whose cells wrap, equations broken at their operators."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence

_GAP = 2
_NARROW = 14
_AS_IT_IS = 4


def visible(text: str) -> str:
    """The text with every character that steers a terminal or turns the direction of writing shown as its escape."""
    return "".join(c if c.isprintable() or c in "\n\t" else c.encode("unicode_escape").decode() for c in text)


def filled(text: str, width: int, first: str = "", then: str = "") -> str:
    """A paragraph in lines of at most ``width``; names and paths are never broken."""
    return textwrap.fill(
        text, width, initial_indent=first, subsequent_indent=then, break_long_words=False, break_on_hyphens=False
    )


def wrapped(text: str, width: int) -> str:
    """Lines with a hanging indent; deeply indented ones, which show something as it is, stay whole."""
    return "\n".join(_wrapped_line(line, width) for line in text.splitlines())


def _wrapped_line(line: str, width: int) -> str:
    indent = len(line) - len(line.lstrip())
    return line if len(line) <= width or indent >= _AS_IT_IS else filled(line, width, then=" " * (indent + 2))


def facts(pairs: Sequence[tuple[str, str]], width: int, indent: str = "") -> Iterator[str]:
    """Lines of names and what they are, the second in a column of its own."""
    size = max(len(name) for name, _ in pairs) + _GAP
    for name, value in pairs:
        if not value:
            yield indent + name
        yield from filled(value, width, f"{indent}{name:{size}}", " " * (len(indent) + size)).splitlines()


def table(headings: Sequence[str], rows: Sequence[Sequence[str]], width: int, indent: str = "  ") -> Iterator[str]:
    """Lines of a table; where it is too wide, the cells of its widest columns wrap."""
    everything = [headings, *rows]
    sizes = [max(len(row[i]) for row in everything) for i in range(len(headings))]
    room = width - len(indent) - _GAP * (len(sizes) - 1)
    while sum(sizes) > room and max(sizes) > _NARROW:
        sizes[sizes.index(max(sizes))] -= 1
    for row in everything:
        cells = [textwrap.wrap(cell, size) or [""] for cell, size in zip(row, sizes, strict=True)]
        for k in range(max(map(len, cells))):
            line = [cell[k] if k < len(cell) else "" for cell in cells]
            yield indent + (" " * _GAP).join(t.ljust(s) for t, s in zip(line, sizes, strict=True)).rstrip()


def equation(text: str, width: int, indent: str = "  ") -> Iterator[str]:
    """Lines of ``left = right``; broken before the outermost operator that still fits, the rest below the right side.

    A choice of branches, ``{ a if b; c otherwise }``, has a line for each.
    """
    line = indent + text
    hang = min(line.find(" = ") + 3, width // 3)
    branches = [line]
    if len(line) > width and "; " in line:
        first, *others = line.split("; ")
        under = line.find("{ ") + 2
        branches = [f"{first};", *(" " * under + f"{other};" for other in others)]
        branches[-1] = branches[-1].removesuffix(";")
        hang = under + 2
    for branch in branches:
        line = branch
        while (at := _break(line, hang, width)) is not None:
            yield line[:at].rstrip()
            line = " " * hang + line[at:]
        yield line


def _break(line: str, hang: int, width: int) -> int | None:
    """Where to break a line that is too long: at the least depth of brackets, and there as far right as fits."""
    if len(line) <= width:
        return None
    best: tuple[int, int] | None = None
    depth = 0
    for i, letter in enumerate(line[:width]):
        depth += (letter in "([{") - (letter in ")]}")
        if line[i : i + 3] in (" + ", " - ") and i > hang + 1 and (best is None or (depth, -i) < best):
            best = depth, -i
    return None if best is None else 1 - best[1]

"""Tables and text as Markdown."""

from __future__ import annotations

import re

from noiseid_cli.report.tables import Cell, Column, Missing, Table, plain, write_number

# Entities rather than backslashes for what would end a cell or open a tag: renderers disagree about `\|`.
_ENTITIES = {"|": "&#124;", "\\": "&#92;", "<": "&lt;", ">": "&gt;", "&": "&amp;", "`": "&#96;"}
_BACKSLASHED = frozenset("*_[]#~$")
_BLOCK_START = re.compile(r"^(\s*)([-+=]|\d+[.)])")


def markdown_text(text: str) -> str:
    """Text that Markdown shows as it is, in a paragraph or in a cell."""
    out = "".join(_ENTITIES.get(c, f"\\{c}" if c in _BACKSLASHED else c) for c in plain(text))
    return _BLOCK_START.sub(lambda m: m[1] + m[2][:-1] + "\\" + m[2][-1], out)


def markdown_code(text: str) -> str:
    """Lines as an indented code block, which no character in them can end."""
    return "\n".join(f"    {plain(line)}" for line in text.splitlines())


def markdown_table(table: Table) -> str:
    """Title, pipe table, caption and the reasons of missing cells."""
    notes = table.notes()
    rules = ["---:" if table.numeric(j) else ":---" for j in range(len(table.columns))]
    lines = [_row([markdown_text(column.title) for column in table.columns]), _row(rules)]
    for row in table.rows:
        lines.append(_row([_cell(cell, column, notes) for cell, column in zip(row, table.columns, strict=True)]))
    below = [
        markdown_text(table.caption),
        *(f"({i}) {markdown_text(note)}." for i, note in enumerate(notes, 1)),
    ]
    return "\n".join([f"**{markdown_text(table.title)}**", "", *lines, "", "  \n".join(filter(None, below)), ""])


def _row(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _cell(cell: Cell, column: Column, notes: list[str]) -> str:
    if isinstance(cell, Missing):
        return f"– ({notes.index(cell.reason) + 1})"
    return markdown_text(cell) if isinstance(cell, str) else str(write_number(cell, column))

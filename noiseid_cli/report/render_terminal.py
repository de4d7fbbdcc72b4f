"""Tables as plain text for a terminal."""

from __future__ import annotations

import textwrap
import unicodedata

from noiseid_cli.report.tables import Cell, Column, Missing, Table, plain, write_number

GAP = "  "

BROKEN_HEADING = 12
"""Characters of a line of a heading that is broken, unless a word or a cell is longer."""

LONGEST_HEADING = 1000
"""Room for a heading on one line, where there is room enough for all."""


def terminal_text(text: str) -> str:
    """Text without any character that commands a terminal."""
    return plain(text)


def terminal_table(table: Table, width: int = 100) -> str:
    """Title, aligned columns, caption and the reasons of missing cells.

    Where a table is wider than ``width``, its headings are broken into lines; if it still is, it is broken into blocks
    of columns, and each repeats the key columns.
    """
    notes = table.notes()
    bodies = [[_cell(row[j], column, notes) for row in table.rows] for j, column in enumerate(table.columns)]
    columns = _set(table, bodies, LONGEST_HEADING)
    if sum(_cells(column[0]) + len(GAP) for column in columns) - len(GAP) > width:
        columns = _set(table, bodies, BROKEN_HEADING)
    lines = [terminal_text(table.title)]
    for block in _blocks(columns, table.keys, width):
        rows = [GAP.join(cells).rstrip() for cells in zip(*block, strict=True)]
        head = len(rows) - len(table.rows)
        lines += ["", *(row for row in rows[:head] if row), "─" * max(_cells(row) for row in rows), *rows[head:]]
    below = [
        terminal_text(table.caption),
        *(f"({i}) {terminal_text(note)}." for i, note in enumerate(notes, 1)),
    ]
    lines += ["", *(line for text in filter(None, below) for line in textwrap.wrap(text, width))]
    return "\n".join(lines).rstrip() + "\n"


def _set(table: Table, bodies: list[list[str]], room: int) -> list[list[str]]:
    """Columns of cells of one width, headings on top: broken where they are longer than ``room`` and their cells."""
    heads = [_heading(c, max(room, *map(_cells, ["", *body]))) for c, body in zip(table.columns, bodies, strict=True)]
    tallest = max(map(len, heads))
    columns = []
    for j, (head, body) in enumerate(zip(heads, bodies, strict=True)):
        # A unit stands in the line below all headings, and headings stand on that line.
        cells = [*[""] * (tallest - len(head)), *head, *body]
        size = max(map(_cells, cells))
        right = table.numeric(j)
        columns.append([" " * (size - _cells(c)) + c if right else c + " " * (size - _cells(c)) for c in cells])
    return columns


def _heading(column: Column, room: int) -> list[str]:
    unit = terminal_text(f"[{column.unit}]" if column.unit else "")
    words = terminal_text(column.heading).split(" ")
    lines = [words[0]]
    for word in words[1:]:
        joined = f"{lines[-1]} {word}"
        if _cells(joined) <= max(room, *map(_cells, words)):
            lines[-1] = joined
        else:
            lines.append(word)
    return [*lines, unit]


def _blocks(columns: list[list[str]], keys: int, width: int) -> list[list[list[str]]]:
    """Split columns into groups that fit, each led by the key columns."""
    lead = columns[:keys]
    lead_width = sum(_cells(column[0]) for column in lead) + len(GAP) * (keys - 1)
    blocks, used = [list(lead)], lead_width
    for column in columns[keys:]:
        size = len(GAP) + _cells(column[0])
        if used + size > width and len(blocks[-1]) > keys:
            blocks.append(list(lead))
            used = lead_width
        blocks[-1].append(column)
        used += size
    return blocks


def _cells(text: str) -> int:
    """Width on a terminal: wide characters take two cells, combining ones none."""
    wide = sum(unicodedata.east_asian_width(c) in "WF" for c in text)
    return len(text) + wide - sum(unicodedata.combining(c) > 0 for c in text)


def _cell(cell: Cell, column: Column, notes: list[str]) -> str:
    if isinstance(cell, Missing):
        return f"– ({notes.index(cell.reason) + 1})"
    return terminal_text(cell) if isinstance(cell, str) else str(write_number(cell, column))

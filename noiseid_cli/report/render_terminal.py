"""Tables as plain text for a terminal."""

from __future__ import annotations

import textwrap
import unicodedata

from noiseid_cli.report.tables import Cell, Column, Missing, Table, plain, write_number

GAP = "  "


def terminal_text(text: str) -> str:
    """Text without any character that commands a terminal."""
    return plain(text)


def terminal_table(table: Table, width: int = 100) -> str:
    """Title, aligned columns, caption and the reasons of missing cells.

    A table wider than ``width`` is broken into blocks of columns; each repeats the key columns.
    """
    notes = table.notes()
    columns = []
    for j, column in enumerate(table.columns):
        cells = [terminal_text(column.heading), terminal_text(f"[{column.unit}]" if column.unit else "")]
        cells += [_cell(row[j], column, notes) for row in table.rows]
        size = max(_cells(cell) for cell in cells)
        right = table.numeric(j)
        columns.append([" " * (size - _cells(c)) + c if right else c + " " * (size - _cells(c)) for c in cells])
    lines = [terminal_text(table.title)]
    for block in _blocks(columns, table.keys, width):
        rows = [GAP.join(cells).rstrip() for cells in zip(*block, strict=True)]
        head = rows[:2] if rows[1] else rows[:1]
        lines += ["", *head, "─" * max(_cells(row) for row in rows), *rows[2:]]
    below = [
        terminal_text(table.caption),
        *(f"({i}) {terminal_text(note)}." for i, note in enumerate(notes, 1)),
    ]
    lines += ["", *(line for text in filter(None, below) for line in textwrap.wrap(text, width))]
    return "\n".join(lines).rstrip() + "\n"


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

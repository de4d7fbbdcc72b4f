"""Tables and text as HTML."""

from __future__ import annotations

from html import escape

from noiseid_cli.report.render_csv import csv_text
from noiseid_cli.report.tables import Cell, Column, Missing, Table, plain, write_number

LONG = 40
"""Characters from which a cell is a sentence."""


def html_text(text: str) -> str:
    """Text that HTML shows as it is, in an element or in a quoted attribute."""
    return escape(plain(text), quote=True)


def html_code(text: str) -> str:
    """Lines of text that HTML shows as they are, for a ``pre`` element."""
    return "\n".join(html_text(line) for line in text.splitlines())


def html_table(table: Table) -> str:
    """A figure with caption, a table that scrolls inside its box, and the reasons of missing cells."""
    notes = table.notes()
    sides = [_side(table, j) for j in range(len(table.columns))]
    heads = "".join(
        f'<th scope="col" class="{side}">{_heading(column)}</th>'
        for column, side in zip(table.columns, sides, strict=True)
    )
    above = [None, *(row[0] for row in table.rows)]
    body = "\n".join(
        _row(row, table.columns, sides, notes, row[0] == before) for row, before in zip(table.rows, above, strict=False)
    )
    reasons = "".join(f"<li>{html_text(note)}.</li>" for note in notes)
    title = html_text(table.title)
    return "\n".join(
        [
            f'<figure class="table" id="table-{html_text(table.name)}">',
            f"<figcaption><strong>{title}.</strong> {html_text(table.caption)}</figcaption>",
            f'<div class="scroll" tabindex="0" role="region" aria-label="{title}">',
            f"<table><thead><tr>{heads}</tr></thead>",
            f"<tbody>\n{body}\n</tbody></table></div>",
            *([f'<ol class="notes">{reasons}</ol>'] if notes else []),
            "</figure>",
        ]
    )


def _side(table: Table, j: int) -> str:
    """Style of a column: numbers to the right, long sentences with room to run."""
    if table.numeric(j):
        return "num"
    return "txt long" if any(len(str(row[j])) > LONG for row in table.rows) else "txt"


def _heading(column: Column) -> str:
    unit = f' <span class="unit">[{html_text(column.unit)}]</span>' if column.unit else ""
    return html_text(column.heading) + unit


def _row(row: tuple[Cell, ...], columns: tuple[Column, ...], sides: list[str], notes: list[str], again: bool) -> str:
    """One row; a heading that repeats the one above is marked, to be set faint."""
    cells = []
    for j, (cell, column) in enumerate(zip(row, columns, strict=True)):
        tag, more = ('th scope="row"', " again" if again else "") if j == 0 else ("td", "")
        cells.append(f'<{tag} class="{sides[j]}{more}"{_value(cell)}>{_cell(cell, column, notes)}</{tag[:2]}>')
    return f"<tr>{''.join(cells)}</tr>"


def _value(cell: Cell) -> str:
    """What a cell is sorted by and copied as, where that is not its text: every digit, and never a formula."""
    if isinstance(cell, str):
        safe = csv_text(cell)
        return "" if safe == plain(cell) else f' data-value="{html_text(safe)}"'
    return f' data-value="{"" if isinstance(cell, Missing) else repr(cell)}"'


def _cell(cell: Cell, column: Column, notes: list[str]) -> str:
    if isinstance(cell, Missing):
        return f'<span title="{html_text(cell.reason)}">–<sup>{notes.index(cell.reason) + 1}</sup></span>'
    if isinstance(cell, str):
        return html_text(cell)
    written = write_number(cell, column)
    digits = written.digits.replace("-", "−")
    return digits if written.exponent is None else f"{digits} × 10<sup>{written.exponent}</sup>".replace("-", "−")

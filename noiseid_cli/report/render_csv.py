"""Tables as CSV: every number in full precision, one heading line, nothing but the cells."""

from __future__ import annotations

import csv
import io

from noiseid_cli.report.tables import Cell, Missing, Table, plain

FORMULA_STARTS = ("=", "+", "-", "@", "＝", "＋", "－", "＠")


def csv_text(text: str) -> str:
    """Text that no spreadsheet takes for a formula: one that starts like a formula gets a leading quote."""
    text = plain(text)
    return f"'{text}" if text.lstrip().startswith(FORMULA_STARTS) else text


def csv_table(table: Table) -> str:
    """The table as CSV; a missing value is an empty cell."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([csv_text(column.title) for column in table.columns])
    writer.writerows([_cell(cell) for cell in row] for row in table.rows)
    return out.getvalue()


def _cell(cell: Cell) -> str:
    if isinstance(cell, Missing):
        return ""
    return csv_text(cell) if isinstance(cell, str) else repr(cell)

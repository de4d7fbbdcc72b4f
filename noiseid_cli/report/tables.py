"""A table as data: typed cells under headings with units, and the one place where numbers become text."""

from __future__ import annotations

import math
import unicodedata
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Missing:
    """A cell without a value, and why."""

    reason: str


Cell = str | int | float | Missing


@dataclass(frozen=True)
class Column:
    """A heading with the unit of what stands below, and how numbers are written there.

    Attributes:
        heading: what the column shows.
        unit: unit of its numbers; empty for none.
        digits: significant digits.
        decimals: digits after the point instead, for numbers that are compared by their difference.
    """

    heading: str
    unit: str = ""
    digits: int = 4
    decimals: int | None = None

    @property
    def title(self) -> str:
        """Heading and unit, such as ``Path error [m]``."""
        return f"{self.heading} [{self.unit}]" if self.unit else self.heading


@dataclass(frozen=True)
class Table:
    """Rows of cells under columns.

    Attributes:
        name: stem of its files and anchor in the page.
        title: what it shows.
        caption: how to read it.
        columns, rows: the cells; a float is finite, what is not known is ``Missing``.
        keys: number of leading columns that say which row it is.
    """

    name: str
    title: str
    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    keys: int = 1

    def __post_init__(self) -> None:
        """Refuse rows of another width and numbers that are none: a fault in the code that made them."""
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"table {self.name}: {len(row)} cells under {len(self.columns)} columns: {row}")
            if any(isinstance(cell, float) and not math.isfinite(cell) for cell in row):
                raise ValueError(f"table {self.name}: a cell is not finite; use number(): {row}")

    def notes(self) -> list[str]:
        """The reasons of all missing cells, each once, in order of appearance; their place is their mark."""
        reasons = (cell.reason for row in self.rows for cell in row if isinstance(cell, Missing))
        return list(dict.fromkeys(reasons))

    def as_data(self) -> dict[str, Any]:
        """The table as plain data for JSON; a missing cell is null."""
        headings = [f"{c.heading} [{c.unit}]" if c.unit else c.heading for c in self.columns]
        rows = [[None if isinstance(cell, Missing) else cell for cell in row] for row in self.rows]
        return {"name": self.name, "title": self.title, "rows": [dict(zip(headings, r, strict=True)) for r in rows]}

    def numeric(self, j: int) -> bool:
        """Whether column j holds numbers (and is set to the right)."""
        cells = [row[j] for row in self.rows if not isinstance(row[j], Missing)]
        return all(isinstance(cell, int | float) for cell in cells)


def number(value: float | None, reason: str) -> Cell:
    """Return a finite number as it is, anything else as missing for this reason."""
    if value is None or not math.isfinite(value):
        return Missing(reason)
    return float(value)


@dataclass(frozen=True)
class Written:
    """A number as text: digits and, in scientific notation, the power of ten."""

    digits: str
    exponent: int | None = None

    def __str__(self) -> str:
        """Plain text, such as ``1.23e-12``."""
        return self.digits if self.exponent is None else f"{self.digits}e{self.exponent}"


def write_number(value: float, column: Column) -> Written:
    """Write a number by the significant digits (or the decimals) of its column; trailing zeros stay."""
    if isinstance(value, int):
        return Written(str(value))
    if column.decimals is not None:
        text = f"{value:.{column.decimals}f}"
        return Written(text.lstrip("-") if float(text) == 0 else text)
    if value == 0:
        return Written("0")
    mantissa, exponent = f"{value:.{column.digits - 1}e}".split("e")
    power = int(exponent)
    if -4 < power < 6:
        return Written(f"{value:.{max(column.digits - 1 - power, 0)}f}")
    return Written(mantissa, power)


def plain(text: str) -> str:
    r"""Text on one line without any character that commands a terminal or a page.

    White space becomes a blank. Control and format characters (escape sequences, changes of direction) and
    lone surrogates, which no file can hold, become their visible code such as ``\x1b``.
    """
    return text if text.isprintable() else "".join(_visible(c) for c in text)


def _visible(character: str) -> str:
    category = unicodedata.category(character)
    if character in "\t\n\r\v\f" or category in ("Zl", "Zp"):
        return " "
    if category in ("Cc", "Cf", "Cs", "Co", "Cn"):
        return character.encode("unicode_escape").decode("ascii")
    return character

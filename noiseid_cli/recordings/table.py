"""What every reader gives: the wanted columns as numbers, and the places that hold none."""

from __future__ import annotations

import difflib
import stat
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from noiseid_cli.errors import DataError, machine_error
from noiseid_cli.models.recording import Array

Key = str | int
"""A column: its name, or its number from 1."""


class BadCell(NamedTuple):
    """A place without a usable number: row (index, from 0), column (empty: the whole row), and what stands there."""

    row: int
    column: Key
    text: str


@dataclass(frozen=True)
class Table:
    """The wanted columns of one log file.

    Attributes:
        columns: (N,) values by column; NaN where the cell is empty or bad.
        names: names of all columns of the file.
        row_numbers: (N,) the line of each row in a text file, else the row counted from 1.
        row_word: ``line`` or ``row``: what the row numbers count.
        bad: the cells that hold something else than a finite number or nothing, ordered by row.
    """

    columns: dict[Key, Array]
    names: tuple[str, ...]
    row_numbers: NDArray[np.int64]
    row_word: str
    bad: tuple[BadCell, ...]


def unknown_column(file: Path, wanted: Key, names: Sequence[str]) -> DataError:
    """The error for a column that the file does not have, with those that it has."""
    close = difflib.get_close_matches(str(wanted), names, n=1)
    hint = f" Did you mean '{close[0]}'?" if close else ""
    shown = ", ".join(f"'{name}'" for name in names[:40]) + (", ..." if len(names) > 40 else "")
    return DataError(f"{file} has no column {wanted!r}; it has {shown or 'none that can be read'}.{hint}")


def checked_bytes(file: Path) -> bytes:
    """The content of a plain file.

    Raises:
        DataError: there is none, or it cannot be read.
    """
    check_plain_file(file)
    try:
        data = file.read_bytes()
    except OSError as error:
        said = f"{file} cannot be read"
        raise machine_error(error, said) or DataError(f"{said}: {error.strerror}. Check its permissions.") from error
    if not data:
        raise DataError(f"{file} is empty; expected a recording.")
    return data


def check_plain_file(file: Path) -> None:
    """Refuse what is not a plain file: opening a pipe would wait for ever.

    Raises:
        DataError: there is no plain file of that name.
    """
    try:
        mode = file.stat().st_mode
    except OSError as error:
        raise DataError(f"{file} cannot be found: {error.strerror}. Check the name in the config.") from error
    if not stat.S_ISREG(mode):
        raise DataError(f"{file} is not a plain file; name a recording in the config.")

"""Text tables: any delimiter, with or without a header, read in one pass and with the line of every fault."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import chain, islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from noiseid_cli.errors import DataError
from noiseid_cli.models.recording import Array
from noiseid_cli.recordings.options import RecordingSource
from noiseid_cli.recordings.table import BadCell, Key, Table, checked_bytes, unknown_column

_DELIMITERS = (",", ";", "\t", "|", " ")
_NOTHING = frozenset({"", "nan", "na", "n/a", "null"})
_SAMPLE = 50  # lines that decide on the delimiter
_BATCH = 20_000  # rows that are held as text at a time

Line = tuple[int, str]
"""Line number from 1, and the text."""


def read_delimited(source: RecordingSource, wanted: Sequence[Key]) -> Table:
    """Read the wanted columns of a text table.

    Empty cells, NaN, NA, N/A and null are missing values. Blank lines and comment lines do not count as rows.

    Raises:
        DataError: the file cannot be read as text, holds no rows, or has no such column.
    """
    data = checked_bytes(source.file)
    lines, delimiter, names, has_header = _opened(source, data)
    places = {key: _place(source.file, key, names, has_header) for key in wanted}
    begin, end = source.rows or (1, None)
    numbers, columns, bad = _collect(islice(lines, begin - 1, end), places, len(names), delimiter, source.decimal)
    if not len(numbers):
        raise DataError(f"{source.file} has no data rows" + (" in the chosen range." if source.rows else "."))
    return Table(columns, names, numbers, "line", bad)


def list_delimited(source: RecordingSource) -> list[Key]:
    """Columns of a text table: names where there is a header that tells them apart, else numbers from 1.

    Raises:
        DataError: the file cannot be read as text, or holds no rows.
    """
    _, _, names, has_header = _opened(source, checked_bytes(source.file))
    return [name if has_header and name and names.count(name) == 1 else k for k, name in enumerate(names, start=1)]


def _opened(source: RecordingSource, data: bytes) -> tuple[Iterator[Line], str, tuple[str, ...], bool]:
    """The data rows still to be read, the delimiter, the names of the columns and whether a header gave them."""
    delimiter = source.delimiter or _find_delimiter(_lines(source, data), source.decimal)
    lines = _lines(source, data)
    first = next(lines, None)
    if first is None:
        raise DataError(f"{source.file} has no rows, only blank lines and comments.")
    cells = [cell.strip() for cell in _split(first[1], delimiter)]
    has_header = _is_header(cells, source.decimal) if source.header is None else source.header
    names = tuple(cells) if has_header else tuple(f"column {k + 1}" for k in range(len(cells)))
    return lines if has_header else chain([first], lines), delimiter, names, has_header


def _lines(source: RecordingSource, data: bytes) -> Iterator[Line]:
    """Number and text of the lines that hold fields."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encoding = "utf-16"
    elif b"\0" in data[:4096]:
        raise DataError(f"{source.file} is not a text file; set its kind in the config (csv, mat, hdf5, npz).")
    else:
        encoding = "utf-8-sig" if _is_utf8(data) else "latin-1"
    text = io.TextIOWrapper(io.BytesIO(data), encoding, errors="replace", newline=None)
    for number, line in enumerate(text, start=1):
        if not line.isspace() and not (source.comment and line.lstrip().startswith(source.comment)):
            yield number, line


def _is_utf8(data: bytes) -> bool:
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return False
    return True


def _split(line: str, delimiter: str) -> list[str]:
    """The fields of a line; a quoted one stays whole."""
    if delimiter == " ":
        return line.split()
    if '"' in line:
        with suppress(csv.Error):  # a quotation mark that is never closed, and more behind it than a field may hold
            return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    return line.rstrip("\n").split(delimiter)


def _find_delimiter(lines: Iterator[Line], decimal: str) -> str:
    """The delimiter that gives most lines the same number of fields, most of them numbers, and most fields.

    A table of one column has none; it is read with the first.
    """
    sample = list(islice(lines, _SAMPLE))
    best, best_score = _DELIMITERS[0], (0.0, 0)
    for delimiter in _DELIMITERS:
        if delimiter == decimal:
            continue
        rows = [_split(line, delimiter) for _, line in sample]
        counts = [len(fields) for fields in rows]
        usual = max(sorted(set(counts)), key=counts.count, default=0)
        if usual < 2:
            continue
        fields = [cell for row in rows if len(row) == usual for cell in row]
        numbers = sum(_number(cell, decimal) is not None for cell in fields)
        score = (round(counts.count(usual) / len(counts) * numbers / len(fields), 6), usual)
        if score > best_score:
            best, best_score = delimiter, score
    return best


def _is_header(cells: list[str], decimal: str) -> bool:
    """The first row holds words and no number: a data row with one bad cell must not vanish as a header."""
    numbers = [_number(cell, decimal) for cell in cells]
    return None in numbers and all(number is None or math.isnan(number) for number in numbers)


def _number(cell: str, decimal: str) -> float | None:
    """The finite number in a cell, NaN for a missing one, None for anything else."""
    if decimal != ".":
        if "." in cell:
            return None
        cell = cell.replace(decimal, ".")
    try:
        value = float(cell)
    except ValueError:
        return float("nan") if cell.strip().lower() in _NOTHING else None
    return None if "_" in cell or value in (float("inf"), float("-inf")) else value


def _place(file: Path, key: Key, names: tuple[str, ...], has_header: bool) -> int:
    """Index of a column, by name or by number from 1."""
    if isinstance(key, int):
        if not 1 <= key <= len(names):
            raise DataError(f"{file} has no column number {key}; it has {len(names)} columns, counted from 1.")
        return key - 1
    if not has_header:
        raise DataError(
            f"{file} has no header with names, so there is no column '{key}': give its number from 1, or set "
            "header: true in the config if the first row holds the names."
        )
    if key not in names:
        raise unknown_column(file, key, names)
    if names.count(key) > 1:
        both = " and ".join(str(k + 1) for k, name in enumerate(names) if name == key)
        raise DataError(f"{file} has more than one column '{key}'; name it by its number: {both}.")
    return names.index(key)


def _collect(
    lines: Iterator[Line], places: dict[Key, int], width: int, delimiter: str, decimal: str
) -> tuple[NDArray[np.int64], dict[Key, Array], tuple[BadCell, ...]]:
    """Line numbers, wanted columns and bad cells; a batch without any fault takes the short way."""
    parts: list[Array] = []
    numbers: list[int] = []
    bad: list[BadCell] = []
    while batch := list(islice(lines, _BATCH)):
        texts = [text for _, text in batch]
        block = _clean_block(texts, list(places.values()), width, delimiter) if decimal == "." else None
        if block is None:
            rows = [_fitted(_split(text, delimiter), width, len(numbers) + k, bad) for k, text in enumerate(texts)]
            block = np.empty((len(rows), len(places)))
            for column, (key, place) in enumerate(places.items()):
                cells = [row[place] for row in rows]
                block[:, column] = _numbers(cells, key, len(numbers), decimal, bad)
        parts.append(block)
        numbers.extend(number for number, _ in batch)
    values = np.concatenate(parts) if parts else np.empty((0, len(places)))
    columns = {key: np.ascontiguousarray(values[:, k]) for k, key in enumerate(places)}
    bad.sort(key=lambda cell: (cell.row, str(cell.column)))
    return np.array(numbers, dtype=np.int64), columns, tuple(bad)


def _clean_block(texts: list[str], places: list[int], width: int, delimiter: str) -> Array | None:
    """(rows, wanted columns), or None if a row has a wrong length or a wanted cell no finite number and no NaN."""
    blanks = delimiter == " "
    # loadtxt does not look at the length of rows of which it takes some columns only.
    if not blanks and any(text.count(delimiter) != width - 1 for text in texts):
        return None
    try:
        block = np.loadtxt(
            texts,
            delimiter=None if blanks else delimiter,
            comments=None,
            usecols=None if blanks else places,
            ndmin=2,
        )
    except ValueError:
        return None
    if blanks:
        if block.shape[1] != width:
            return None
        block = block[:, places]
    return block if len(block) == len(texts) and not np.isinf(block).any() else None


def _fitted(fields: list[str], width: int, row: int, bad: list[BadCell]) -> list[str]:
    """The row if it has the right length; a delimiter at its end is allowed."""
    if len(fields) == width or (len(fields) == width + 1 and not fields[-1].strip()):
        return fields
    bad.append(BadCell(row, "", f"{len(fields)} fields where {width} are expected"))
    return [""] * width


def _numbers(cells: list[str], key: Key, offset: int, decimal: str, bad: list[BadCell]) -> Array:
    """The cells as numbers, NaN where there is none; what is neither number nor nothing is noted in ``bad``."""
    values = np.empty(len(cells))
    for k, cell in enumerate(cells):
        number = _number(cell, decimal)
        values[k] = np.nan if number is None else number
        if number is None:
            bad.append(BadCell(offset + k, key, cell.strip()))
    return values

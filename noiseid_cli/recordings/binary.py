"""MAT, HDF5 and npz files: read by a process of its own, so that a damaged file cannot take this one down."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from noiseid_cli.errors import DataError
from noiseid_cli.models.recording import Array
from noiseid_cli.recordings.options import RecordingSource
from noiseid_cli.recordings.table import BadCell, Key, Table, check_plain_file, unknown_column

TIME_LIMIT = 10.0
"""s that the reading process may take."""

_CHILD = Path(__file__).with_name("reading_process.py")


def read_binary(source: RecordingSource, kind: str, wanted: Sequence[Key]) -> Table:
    """Read the wanted columns of a MAT (v4 to v7.3), HDF5 or npz file.

    Raises:
        DataError: the file is damaged, points into other files, or has no such column.
    """
    file = source.file
    check_plain_file(file)
    for key in wanted:
        if isinstance(key, int):
            raise DataError(f"{file}: columns go by number in CSV files only; write a name in place of {key}.")
    answer, arrays = _ask(file, kind, {"wanted": [str(key) for key in wanted]})
    names = tuple(answer["names"])
    if "unknown" in answer:
        raise unknown_column(file, answer["unknown"], names)
    lengths = {key: len(array) for key, array in zip(wanted, arrays, strict=True)}
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"'{key}' {length}" for key, length in lengths.items())
        raise DataError(f"{file}: the columns differ in length: {told}. Take columns of one recording.")
    begin, end = source.rows or (1, None)
    columns = {key: array[begin - 1 : end].copy() for key, array in zip(wanted, arrays, strict=True)}
    count = len(next(iter(columns.values())))
    if not count:
        raise DataError(f"{file} has no data rows" + (" in the chosen range." if source.rows else "."))
    bad = []
    for key, values in columns.items():
        for row in np.flatnonzero(np.isinf(values)):
            bad.append(BadCell(int(row), key, str(values[row])))
            values[row] = np.nan
    rows = np.arange(begin, begin + count, dtype=np.int64)
    return Table(columns, names, rows, "row", tuple(sorted(bad, key=lambda cell: (cell.row, str(cell.column)))))


def list_binary(file: Path, kind: str) -> list[str]:
    """The columns of the recording in a MAT, HDF5 or npz file: those of the length that most of them have.

    Raises:
        DataError: the file is damaged or missing, or no two numbers in it stand one after the other.
    """
    check_plain_file(file)
    columns: list[tuple[str, int]] = [
        (name, length) for name, length in _ask(file, kind, {"wanted": None})[0]["columns"]
    ]
    lengths = [length for _, length in columns if length > 1]
    if not lengths:
        raise DataError(f"{file} holds no column of numbers; expected a recording.")
    usual = max(sorted(set(lengths), reverse=True), key=lengths.count)
    return [name for name, length in columns if length == usual]


def ask_whole(file: Path, kind: str, wanted: Sequence[str], optional: Sequence[str] = ()) -> dict[str, Array]:
    """Whole arrays of such a file, in their shapes.

    Raises:
        DataError: the file is damaged, or has no such array.
    """
    check_plain_file(file)
    answer, arrays = _ask(file, kind, {"wanted": list(wanted), "optional": list(optional), "whole": True})
    if "unknown" in answer:
        raise unknown_column(file, answer["unknown"], tuple(answer["names"]))
    shaped = zip(answer["found"], answer["shapes"], arrays, strict=True)
    return {name: array.reshape(shape).copy() for name, shape, array in shaped}


def _ask(file: Path, kind: str, question: dict[str, Any]) -> tuple[dict[str, Any], list[Array]]:
    """Let the reading process read; its answer is one line of JSON and then the columns as f8."""
    request = json.dumps({"file": str(file.resolve()), "kind": kind, **question})
    # No plugin from a folder on this machine may be loaded because a file asks for it.
    environment = os.environ | {"HDF5_PLUGIN_PRELOAD": "::", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-P", str(_CHILD), request]
    try:
        done = subprocess.run(command, capture_output=True, timeout=TIME_LIMIT, check=False, env=environment)
    except subprocess.TimeoutExpired as error:
        raise DataError(
            f"{file} could not be read within {TIME_LIMIT:g} s; it is damaged or far too large. "
            "Export the columns you need as CSV."
        ) from error
    if done.returncode:
        number = -done.returncode
        cause = signal.Signals(number).name if number > 0 else f"exit code {done.returncode}"
        raise DataError(
            f"{file} is damaged: the library that reads {kind} files broke down on it ({cause}). "
            "Take a fresh copy, or export the columns as CSV."
        )
    head, _, body = done.stdout.partition(b"\n")
    answer = json.loads(head)
    if "error" in answer:
        raise DataError(f"{file}: {answer['error']}")
    values = np.frombuffer(body, dtype="<f8")
    return answer, np.split(values, np.cumsum(answer["lengths"])[:-1]) if "lengths" in answer else []

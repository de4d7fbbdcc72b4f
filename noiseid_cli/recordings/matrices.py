"""Matrices from files: CSV with one matrix, or npz, MAT and HDF5 with one or more, which may vary over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from noiseid_cli.errors import DataError
from noiseid_cli.models.recording import Array
from noiseid_cli.recordings.binary import ask_whole
from noiseid_cli.recordings.delimited import read_delimited
from noiseid_cli.recordings.options import RecordingSource, TimeMap
from noiseid_cli.recordings.readers import kind_of


def read_matrix(file: Path) -> Array:
    """(rows, columns) the numbers of a CSV file without a header.

    Raises:
        DataError: the file cannot be read, or holds something else than a full table of finite numbers.
    """
    if kind_of(file, "take csv") != "csv":
        raise DataError(f"{file}: one matrix comes from a CSV file; npz, MAT and HDF5 files go under `file`.")
    source = RecordingSource("matrix", file, TimeMap(interval=1.0), {}, {}, header=False)
    count = len(read_delimited(source, [1]).names)
    table = read_delimited(source, list(range(1, count + 1)))
    if table.bad:
        cell = table.bad[0]
        place = f"{table.row_word} {table.row_numbers[cell.row]}"
        raise DataError(f"{file}, {place}: {cell.text} where a finite number is needed.")
    matrix = np.column_stack([table.columns[k] for k in range(1, count + 1)])
    if np.isnan(matrix).any():
        row = int(np.flatnonzero(np.isnan(matrix).any(axis=1))[0])
        raise DataError(f"{file}, {table.row_word} {table.row_numbers[row]}: an entry is missing.")
    return matrix


def read_matrices(file: Path, wanted: Sequence[str], optional: Sequence[str] = ()) -> dict[str, Array]:
    """Matrices by name: (rows, columns), or (samples, rows, columns) where one varies over time.

    MAT files have time last, as MATLAB writes A(:,:,k); here it comes first.

    Args:
        file: npz, MAT or HDF5 file.
        wanted: names that must be there.
        optional: names that may be there.

    Raises:
        DataError: the file cannot be read, or a wanted matrix is not there or none.
    """
    kind = kind_of(file, "take npz, mat or h5")
    if kind == "csv":
        raise DataError(f"{file}: a CSV file holds one matrix: name it at its letter, as in A: {file.name}.")
    arrays = ask_whole(file, kind, wanted, optional)
    out = {}
    for name, array in arrays.items():
        if array.ndim not in (2, 3):
            raise DataError(
                f"{file}: '{name}' has the shape {array.shape}; a matrix has rows and columns, and may have time."
            )
        out[name] = np.moveaxis(array, -1, 0) if array.ndim == 3 and kind == "mat" else array
    return out

"""Reads columns of a MAT, HDF5 or npz file that noiseid did not write. Run as a script, in a process of its own.

Argument: JSON with ``file``, ``kind`` and ``wanted`` (null: list what there is). Output: one line of JSON, ``names``
with ``lengths`` or ``unknown``, ``columns`` with their lengths, or ``error``; then the wanted columns, one after the
other, as little-endian f8. It imports nothing of noiseid, so that it starts fast, and it follows nothing that leads
out of the file.
"""

from __future__ import annotations

import json
import math
import re
import resource
import sys
import warnings
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np

GIB = 2**30
MEMORY_LIMIT = 4 * GIB
COLUMN_LIMIT = GIB
MAX_NAMES = 10_000
MAX_COLUMNS = 64
MAX_LINKS = 16
HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"


class RefusedError(Exception):
    """The file or a column cannot be taken; the text says why."""


class UnknownError(Exception):
    """There is no column of that name."""


def main(request: dict[str, Any]) -> None:
    """Answer one request on stdout."""
    with suppress(ValueError, OSError):  # some systems know no such limit; the time limit holds everywhere
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT, MEMORY_LIMIT))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    warnings.simplefilter("ignore")
    columns: list[np.ndarray] = []
    try:
        answer = _answer(request, columns)
    except RefusedError as error:
        answer = {"error": str(error)}
    except MemoryError:
        answer = {"error": f"it needs more than {MEMORY_LIMIT // GIB} GiB to read; export the columns as CSV."}
    except Exception as error:
        text = f"{type(error).__name__}: {error}"[:300]
        answer = {"error": f"it cannot be read as a {request['kind']} file ({text}). It may be damaged."}
    sys.stdout.buffer.write(json.dumps(answer).encode() + b"\n")
    for column in columns:
        sys.stdout.buffer.write(column.tobytes())


def _answer(request: dict[str, Any], columns: list[np.ndarray]) -> dict[str, Any]:
    opener = {"mat": open_mat, "hdf5": open_hdf5, "npz": open_npz}[request["kind"]]
    whole = request.get("whole", False)
    store: Any = open_mat(request["file"], squeeze=False) if whole and opener is open_mat else opener(request["file"])
    if request["wanted"] is None:
        return {"columns": list(_columns_listed(store))}
    found, shapes = [], []
    for wanted in [*request["wanted"], *request.get("optional", ())]:
        try:
            values = _whole(store, wanted) if whole else _column(store, wanted)
        except UnknownError:
            if wanted in request.get("optional", ()):
                continue
            columns.clear()
            return {"names": list(store.names()), "unknown": wanted}
        columns.append(values)
        found.append(wanted)
        shapes.append(list(values.shape))
    return {
        "names": list(store.names()),
        "found": found,
        "shapes": shapes,
        "lengths": [column.size for column in columns],
    }


def _whole(store: Any, wanted: str) -> np.ndarray:
    """An array as it stands."""
    return np.ascontiguousarray(store.values(_numeric(store, wanted, store.find(wanted))), dtype="<f8")


def _numeric(store: Any, wanted: str, array: Any) -> Any:
    """The same array, after a look at its type and size."""
    if array.dtype.kind not in "iufb":
        raise RefusedError(f"'{wanted}' holds {array.dtype} where plain real numbers are needed.")
    shape = store.shape(array)
    if np.prod(shape, dtype=float) * array.dtype.itemsize > COLUMN_LIMIT:
        raise RefusedError(f"'{wanted}' declares the shape {shape}, more than {COLUMN_LIMIT // GIB} GiB.")
    return array


def _columns_listed(store: Any) -> Iterator[tuple[str, int]]:
    """Name and length of what could be asked for: vectors by name, the columns of a matrix as ``name[2]``."""
    for name in store.names():
        try:
            array = store.find(name)
        except (RefusedError, UnknownError):
            continue
        if array.dtype.kind not in "iufb":
            continue
        shape = store.shape(array)
        if math.prod(shape) == max((1, *shape)):
            yield name, math.prod(shape)
        elif len(shape) == 2 and shape[1] <= MAX_COLUMNS:
            yield from ((f"{name}[{k + 1}]", shape[0]) for k in range(shape[1]))


def _column(store: Any, wanted: str) -> np.ndarray:
    """``name``: a vector; ``name[2]``: the second column of a matrix."""
    try:
        array, number = store.find(wanted), None
    except UnknownError:
        match = re.fullmatch(r"(.+)\[([0-9]{1,9})\]", wanted)
        if match is None:
            raise
        array, number = store.find(match[1]), int(match[2])
    values = store.values(_numeric(store, wanted, array))
    shape = store.shape(array)
    if number is None:
        if values.size != max((1, *values.shape)):
            raise RefusedError(f"'{wanted}' has the shape {shape}; name one of its columns, as in '{wanted}[1]'.")
        values = values.reshape(-1)
    else:
        if values.ndim != 2 or not 1 <= number <= values.shape[1]:
            raise RefusedError(f"'{wanted}': the shape is {shape}, so there is no column {number}.")
        values = values[:, number - 1]
    return np.ascontiguousarray(values, dtype="<f8")


class Arrays:
    """Columns that are arrays in memory already."""

    def __init__(self, arrays: dict[str, np.ndarray], separator: str = "/") -> None:
        self.arrays = arrays
        self.separator = separator

    def names(self) -> list[str]:
        """All columns that could be asked for."""
        return list(self.arrays)[:MAX_NAMES]

    def find(self, name: str) -> np.ndarray:
        """The array or dataset of that name; UnknownError if there is none."""
        name = name.replace("/", self.separator)
        if name not in self.arrays:
            raise UnknownError
        return self.arrays[name]

    def shape(self, array: np.ndarray) -> tuple[int, ...]:
        """Its shape as the user sees it."""
        return array.shape

    def values(self, array: np.ndarray) -> np.ndarray:
        """Its numbers as the user sees them."""
        return array


def open_npz(file: str) -> Arrays:
    """A numpy archive, or one array in a .npy file under the name ``array``."""
    with np.load(file, allow_pickle=False) as archive:
        if isinstance(archive, np.ndarray):
            return Arrays({"array": archive})
        return Arrays({name: archive[name] for name in archive.files})


def open_mat(file: str, squeeze: bool = True) -> Any:
    """A MAT file of any version; v7.3 is HDF5 behind a header of 512 bytes. Squeezed, its structures are opened too."""
    with open(file, "rb") as stream:  # noqa: PTH123 - a string, and a script that starts fast
        if stream.read(520)[512:] == HDF5_MAGIC:
            return Hdf5(file, separator=".", transposed=True)
    from scipy.io import loadmat

    content = loadmat(file, simplify_cells=squeeze)
    content = {name: value for name, value in content.items() if not name.startswith("__")}
    if not squeeze:
        return Arrays({name: value for name, value in content.items() if np.asarray(value).dtype.kind in "iufb"})
    return Arrays(dict(_flattened(content, "")), separator=".")


def _flattened(content: dict[str, Any], prefix: str) -> Iterator[tuple[str, np.ndarray]]:
    """Numeric arrays of nested structs under dotted names."""
    for name, value in content.items():
        if isinstance(value, dict):
            yield from _flattened(value, f"{prefix}{name}.")
        elif np.asarray(value).dtype.kind in "iufb":
            yield prefix + name, np.atleast_1d(value)


def open_hdf5(file: str) -> Hdf5:
    """An HDF5 file; columns go by their path."""
    return Hdf5(file, separator="/", transposed=False)


class Hdf5:
    """Columns that are datasets in an HDF5 file."""

    def __init__(self, file: str, separator: str, transposed: bool) -> None:
        import h5py

        self.h5py = h5py
        self.file = h5py.File(file, "r", locking=False)
        self.separator = separator
        self.transposed = transposed  # MATLAB writes its columns as rows

    def names(self) -> list[str]:
        """All columns that could be asked for."""
        found: list[str] = []

        def visit(name: str, item: Any) -> bool | None:
            if isinstance(item, self.h5py.Dataset) and item.dtype.kind in "iufb":
                found.append(name.replace("/", self.separator))
            return True if len(found) >= MAX_NAMES else None

        self.file.visititems(visit)
        return found

    def find(self, name: str) -> Any:
        """The array or dataset of that name; UnknownError if there is none."""
        path = name.replace(".", "/") if self.separator == "." else name
        item = self._walk(self.file, path, MAX_LINKS)
        if not isinstance(item, self.h5py.Dataset):
            raise UnknownError
        if item.external:
            raise RefusedError(f"'{name}' keeps its data in another file; noiseid reads no other file.")
        if item.is_virtual:
            raise RefusedError(f"'{name}' is a virtual dataset, made of other data; store the data itself.")
        return item

    def _walk(self, group: Any, path: str, links: int) -> Any:
        """Follow a path link by link, never out of the file."""
        item = self.file if path.startswith("/") else group
        for part in filter(None, path.split("/")):
            if part == ".":
                continue
            if not isinstance(item, self.h5py.Group) or part not in item.keys():  # noqa: SIM118 - `in` follows links
                raise UnknownError
            link = item.get(part, getlink=True)
            if isinstance(link, self.h5py.ExternalLink):
                raise RefusedError(f"'{part}' is a link into another file; noiseid follows none.")
            if isinstance(link, self.h5py.SoftLink):
                if links == 0:
                    raise RefusedError(f"'{part}' is a link that leads through too many others.")
                item = self._walk(item, link.path, links - 1)
            else:
                item = item[part]
        return item

    def shape(self, item: Any) -> tuple[int, ...]:
        """Its shape as the user sees it."""
        shape = item.shape or ()
        return shape[::-1] if self.transposed else shape

    def values(self, item: Any) -> np.ndarray:
        """Its numbers as the user sees them."""
        values = np.asarray(item[()])
        return values.T if self.transposed else values


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))

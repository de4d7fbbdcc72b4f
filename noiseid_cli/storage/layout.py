"""Named dimensions, units and columns in an HDF5 file, in the form that xarray and netCDF programs expect."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from noiseid_cli.errors import DataError
from noiseid_cli.models.recording import Array

if TYPE_CHECKING:
    import h5py

Columns = tuple[tuple[str, str, str], ...]
_LARGE = 512  # numbers; smaller arrays are not worth a compression header


def add_labels(group: h5py.Group, name: str, labels: Sequence[str], long_name: str) -> None:
    """A dimension whose entries have names; one of length zero is left out."""
    _check_text(labels, name)
    if labels:
        _scale(group, name, np.array(list(labels), dtype=object), long_name)


def add_index(group: h5py.Group, name: str, length: int, long_name: str, first: int = 0) -> None:
    """A dimension that counts; one of length zero is left out."""
    if length:
        _scale(group, name, np.arange(first, first + length, dtype=np.int64), long_name)


def add_columns(group: h5py.Group, name: str, columns: Columns, long_name: str) -> None:
    """A dimension of named columns, with ``<name>_unit`` and ``<name>_description`` along it."""
    add_labels(group, name, [column[0] for column in columns], long_name)
    for k, part in ((1, "unit"), (2, "description")):
        texts = [column[k] for column in columns]
        _check_text(texts, f"{name}_{part}")
        if texts:
            item = group.create_dataset(f"{name}_{part}", data=np.array(texts, dtype=object), dtype=_text())
            item.attrs["long_name"] = f"{part} of each {name}"
            item.dims[0].attach_scale(group[name])


def columns_of(group: h5py.Group, name: str) -> Columns:
    """What ``add_columns`` wrote."""
    if name not in group:
        return ()
    parts = [group[f"{name}{part}"].asstr()[()] for part in ("", "_unit", "_description")]
    return tuple((str(a), str(b), str(c)) for a, b, c in zip(*parts, strict=True))


def labels_of(group: h5py.Group, name: str) -> tuple[str, ...]:
    """What ``add_labels`` wrote."""
    return tuple(str(text) for text in group[name].asstr()[()]) if name in group else ()


def put(
    group: h5py.Group,
    name: str,
    values: Array | np.ndarray | float | int,
    dims: Sequence[str] = (),
    units: str = "1",
    long_name: str = "",
    coordinates: str = "",
) -> None:
    """Write one variable with its dimensions, unit and meaning; an array without entries is left out.

    Floats are kept as f8 and integers as i8. Large arrays are compressed, without loss. A dimension is looked for
    in the group itself, then at the root.

    Raises:
        DataError: an axis is not as long as its dimension.
    """
    array = np.asarray(values)
    array = array.astype(np.int64 if array.dtype.kind in "iub" else np.float64)
    if array.shape and not array.size:
        return
    options = {"compression": "gzip", "shuffle": True, "fletcher32": True} if array.size > _LARGE else {}
    item = group.create_dataset(name, data=array, dtype=array.dtype, track_times=False, **options)
    item.attrs["units"] = units
    item.attrs["long_name"] = long_name
    if coordinates:
        item.attrs["coordinates"] = coordinates
    for axis, dim in enumerate(dims):
        scale = group[dim] if dim in group else group.file[dim]
        if len(scale) != array.shape[axis]:
            raise DataError(f"'{name}' has {array.shape[axis]} entries along '{dim}', which names {len(scale)}.")
        item.dims[axis].attach_scale(scale)


def get(group: h5py.Group, name: str, shape: tuple[int, ...]) -> Array:
    """Read a variable written by ``put``; one that was left out has ``shape``, which holds no entries."""
    if name not in group and 0 in shape:
        return np.zeros(shape)
    return np.asarray(group[name][()], dtype=np.float64)


def common_unit(columns: Columns, dim: str) -> str:
    """The unit of all columns, or where to look for it."""
    units = {column[1] for column in columns}
    return units.pop() if len(units) == 1 else f"see {dim}_unit"


def in_words(columns: Columns) -> str:
    """The columns with their units on one line, such as ``q1 [rad], q2 [rad]``."""
    return ", ".join(f"{name} [{unit}]" for name, unit, _ in columns)


def _scale(group: h5py.Group, name: str, values: np.ndarray, long_name: str) -> None:
    dtype = _text() if values.dtype == object else values.dtype
    item = group.create_dataset(name, data=values, dtype=dtype, track_times=False)
    item.make_scale(name)
    item.attrs["long_name"] = long_name


def _text() -> np.dtype:
    import h5py

    return h5py.string_dtype("utf-8")  # type: ignore[no-any-return]


def _check_text(texts: Sequence[str], where: str) -> None:
    for text in texts:
        if "\0" in text:
            raise DataError(f"'{where}' holds the text {text!r}; HDF5 cannot keep a NUL character.")

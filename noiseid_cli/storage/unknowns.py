"""Scalar unknowns and curves in a result file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from noiseid_cli.estimators.estimate import Parameters, Series
from noiseid_cli.models.recording import Array
from noiseid_cli.storage.layout import add_columns, add_index, columns_of, get, put

if TYPE_CHECKING:
    import h5py


def fill_parameters(group: h5py.Group, parameters: Parameters, truth: Array | None) -> None:
    """Write the scalar unknowns; each has its own unit."""
    add_columns(group, "parameter", parameters.names, "unknown")
    known = {"start": parameters.start, "final": parameters.final, "truth": truth}
    known["standard_error"] = parameters.standard_errors
    known["log_scale"] = np.array(parameters.log_scale, dtype=float) if parameters.log_scale else None
    for name, values in known.items():
        group.attrs[f"has_{name}"] = int(values is not None)
        if values is not None:
            put(group, name, values, ("parameter",), "see parameter_unit", f"{name.replace('_', ' ')} of each unknown")


def fill_series(parent: h5py.Group, series: Series) -> None:
    """Write curves as a group of their own."""
    group = parent.create_group(series.name)
    group.attrs["title"] = series.title
    axis, unit = series.axis
    group.attrs["axis"], group.attrs["axis_unit"] = axis, unit
    add_index(group, "point", len(series.at), "number of the point")
    add_columns(group, "curve", series.columns, "curve")
    put(group, "at", series.at, ("point",), unit or "1", axis)
    put(group, "values", series.values, ("point", "curve"), "see curve_unit", series.title, "at")


def read_parameters(file: h5py.File) -> Parameters | None:
    """What ``fill_parameters`` wrote; None where there is nothing."""
    if "parameters" not in file:
        return None
    start, final, errors = (parameter_values(file, name) for name in ("start", "final", "standard_error"))
    assert start is not None
    assert final is not None
    scale = parameter_values(file, "log_scale")
    log_scale = () if scale is None else tuple(bool(value) for value in scale)
    return Parameters(columns_of(file["parameters"], "parameter"), start, final, errors, log_scale)


def parameter_values(file: h5py.File, name: str) -> Array | None:
    """One value of each scalar unknown; None where none was written."""
    if "parameters" not in file or not file["parameters"].attrs[f"has_{name}"]:
        return None
    group = file["parameters"]
    return get(group, name, (len(columns_of(group, "parameter")),))


def read_series(name: str, group: h5py.Group) -> Series:
    """What ``fill_series`` wrote."""
    columns = columns_of(group, "curve")
    points = len(group["point"]) if "point" in group else 0
    axis = (str(group.attrs["axis"]), str(group.attrs["axis_unit"]))
    values = get(group, "values", (points, len(columns)))
    return Series(name, str(group.attrs["title"]), axis, get(group, "at", (points,)), columns, values)


def fill_state(group: h5py.Group, state: dict[str, np.ndarray[Any, Any]]) -> None:
    """Write the arrays that an estimator goes on from; texts and single numbers as attributes."""
    for name, array in state.items():
        if array.ndim == 0:
            group.attrs[name] = array.item()
        else:
            group.create_dataset(name, data=array, dtype=array.dtype, track_times=False)


def read_state(file: h5py.File) -> dict[str, np.ndarray[Any, Any]]:
    """What ``fill_state`` wrote."""
    if "continuation" not in file:
        return {}
    group = file["continuation"]
    single = {name: np.array(value) for name, value in group.attrs.items()}
    return single | {name: np.asarray(item[()]) for name, item in group.items()}

"""Standard errors, intervals and information in a result file."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np

from noiseid_cli.estimators.estimate import Uncertainty
from noiseid_cli.storage.layout import add_columns, add_index, add_labels, columns_of, get, labels_of, put

if TYPE_CHECKING:
    import h5py

_FIGURES = {
    "values": "estimate of each figure",
    "standard_errors": "standard error; NaN where the data do not determine it",
    "lower": "lower end of the interval",
    "upper": "upper end of the interval",
}
_TEXTS = ("notes", "directions", "remarks")


def fill_uncertainty(group: h5py.Group, found: Uncertainty) -> None:
    """Write how sure an estimate is; each figure has its own unit, its description is the metric's name."""
    group.attrs["method"], group.attrs["level"] = found.method, found.level
    for name in _TEXTS:
        group.attrs[name] = json.dumps(getattr(found, name), ensure_ascii=False)
    add_columns(group, "figure", tuple((index, unit, metric) for metric, index, unit in found.names), "figure")
    for name, long_name in _FIGURES.items():
        put(group, name, getattr(found, name), ("figure",), "see figure_unit", long_name)
    # A variable may have a dimension only once.
    add_labels(group, "coordinate", found.coordinates, "free coordinate")
    add_labels(group, "coordinate_", found.coordinates, "free coordinate, again")
    put(group, "information", found.information, ("coordinate", "coordinate_"), "1", "observed information")
    add_index(group, "direction", len(found.shares), "eigen-direction, weakest first")
    share = "share of the complete-data information along each eigen-direction"
    put(group, "shares", found.shares, ("direction",), "1", share)


def read_uncertainty(file: h5py.File) -> Uncertainty | None:
    """What ``fill_uncertainty`` wrote; None where there is nothing."""
    if "uncertainty" not in file:
        return None
    group = file["uncertainty"]
    names = tuple((metric, index, unit) for index, unit, metric in columns_of(group, "figure"))
    coordinates = labels_of(group, "coordinate")
    d = len(coordinates)
    values, errors, lower, upper = (get(group, name, (len(names),)) for name in _FIGURES)
    notes, directions, remarks = (tuple(map(str, json.loads(group.attrs[name]))) for name in _TEXTS)
    return Uncertainty(
        method=str(group.attrs["method"]),
        level=float(group.attrs["level"]),
        names=names,
        coordinates=coordinates,
        information=get(group, "information", (d, d)),
        shares=get(group, "shares", (0,)) if "shares" in group else np.zeros(0),
        values=values,
        standard_errors=errors,
        lower=lower,
        upper=upper,
        notes=notes,
        directions=directions,
        remarks=remarks,
    )

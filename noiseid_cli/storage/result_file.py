"""Result files: what one unit of work ended with.

Format ``noiseid-result``, version 1. The root holds names and totals; ``start`` and ``final`` the noise values,
``trace`` their history, ``evaluation/<label>`` how a filter with them agrees with the data, ``held_out/<label>`` how
with data that no method has seen, ``truth`` what made it, ``tuning`` what is in use today, ``uncertainty`` how sure
the estimate is.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from noiseid_cli import __version__
from noiseid_cli.estimators.estimate import Estimate
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array
from noiseid_cli.outcome import UnitResult
from noiseid_cli.storage import hdf5
from noiseid_cli.storage.atomic import publish
from noiseid_cli.storage.evaluation import fill_evaluation, read_evaluation
from noiseid_cli.storage.layout import add_columns, add_index, add_labels, columns_of, get, labels_of, put
from noiseid_cli.storage.uncertainty import fill_uncertainty, read_uncertainty
from noiseid_cli.storage.unknowns import (
    fill_parameters,
    fill_series,
    fill_state,
    parameter_values,
    read_parameters,
    read_series,
    read_state,
)

if TYPE_CHECKING:
    import h5py

FORMAT = "noiseid-result"
VERSION = 1
MIGRATIONS: dict[int, hdf5.Migration] = {}

_Q = (
    ("noise", "noise_"),
    "product of the noises' units",
    "covariance of the process noise, see noise_unit",
)
_R = (("output", "output_"), "product of the outputs' units", "covariance of the measurement noise")
_M0 = (("test", "state"), "see state_unit", "mean of the first state of each test")
_P0 = (("state", "state_"), "product of the states' units", "covariance of the first state")
_VALUES = {"Q": _Q, "R": _R, "m0": _M0, "P0": _P0}
_TRACE = {
    "loglik": "log-likelihood",
    "change": "relative size of the step",
    "extrapolated": "1 where the point came from the acceleration",
    "accepted": "0 where the point was rejected",
}
_SETTINGS = (
    "unit", "dataset", "method_label", "method", "status", "reason", "start_index", "start_label", "replicate", "seed",
    "held_out_tests",
)  # fmt: skip
_OWN = ("settings", "safeguards", "created_by", "density", "noise_interval")
_TAKEN = frozenset({"format", "format_version", *_SETTINGS, *_OWN})


def write_result(path: Path, result: UnitResult, attributes: dict[str, str]) -> None:
    """Write ``result`` to ``path``, complete or not at all.

    Args:
        path: the file; what stood there is replaced.
        result: the unit's result.
        attributes: texts to keep with it, such as the unit's key, the resolved config and the provenance.

    Raises:
        DataError: the result's arrays contradict its names, or the file cannot be written.
    """

    def fill(file: h5py.File) -> None:
        estimate = result.estimate
        own = {name: getattr(result, name, None) for name in _SETTINGS}
        own |= {"method": estimate.method, "status": estimate.status, "reason": estimate.reason}
        own["seed"] = str(result.seed)  # a seed may be longer than any HDF5 integer
        own |= {
            "settings": json.dumps(estimate.settings, ensure_ascii=False),
            "safeguards": json.dumps(estimate.safeguards, ensure_ascii=False),
            "created_by": f"noiseid {__version__}",
        }
        hdf5.set_attributes(file, own)
        hdf5.set_attributes(file, attributes, _TAKEN)
        file.attrs["density"] = int(result.density)
        file.attrs["noise_interval"] = math.nan if result.interval is None else result.interval
        _fill_dimensions(file, result)
        _fill_estimate(file, result)
        for name, found in (("evaluation", result.evaluations), ("held_out", result.held_out)):
            group = file.create_group(name, track_order=True)
            for label, evaluation in found.items():
                fill_evaluation(group, label, evaluation)

    publish(path, hdf5.build(FORMAT, VERSION, fill))


def read_result(path: Path) -> UnitResult:
    """Read a result file, bit for bit what was written.

    Raises:
        DataError: the file is missing, damaged, of another kind or too new.
    """
    with hdf5.opened(path, FORMAT, VERSION, MIGRATIONS) as file:
        return _result(file)


def read_result_attributes(path: Path) -> dict[str, str]:
    """Read the texts kept with a result: those given to ``write_result`` and the format's own.

    Raises:
        DataError: as for ``read_result``.
    """
    with hdf5.opened(path, FORMAT, VERSION, MIGRATIONS) as file:
        return hdf5.text_attributes(file)


def _fill_dimensions(file: h5py.File, result: UnitResult) -> None:
    add_labels(file, "test", result.test_names, "test")
    for name, columns, long_name in (
        ("noise", result.noise_names, "process noise"),
        ("output", result.output_names, "measured output"),
        ("state", result.state_names, "state"),
    ):
        add_columns(file, name, columns, long_name)
        # A variable may have a dimension only once, so a covariance has a second one of the same names.
        add_labels(file, f"{name}_", [column[0] for column in columns], f"{long_name}, again")


def _fill_estimate(file: h5py.File, result: UnitResult) -> None:
    estimate = result.estimate
    put(file, "loglik_start", estimate.loglik_start, long_name="log-likelihood at the start")
    put(file, "loglik", estimate.loglik, long_name="log-likelihood of the estimate")
    put(file, "passes", estimate.passes, long_name="passes over the data")
    put(file, "estimation_seconds", estimate.seconds, units="s", long_name="wall-clock time of the estimation")
    put(file, "unit_seconds", result.seconds, units="s", long_name="wall-clock time of the unit")
    for name, values in (("start", estimate.start), ("final", estimate.final)):
        group = file.create_group(name)
        for letter, (dims, units, long_name) in _VALUES.items():
            put(group, letter, getattr(values, letter), dims, units, long_name)
    truth = file.create_group("truth")
    for letter, true in (("Q", result.Q_true), ("R", result.R_true)):
        if true is not None:
            put(truth, letter, true, *_VALUES[letter])
    tuning = file.create_group("tuning")
    for letter, used in (("Q", result.Q_tuning), ("R", result.R_tuning)):
        if used is not None:
            put(tuning, letter, used, *_VALUES[letter])
    if result.uncertainty is not None:
        fill_uncertainty(file.create_group("uncertainty"), result.uncertainty)
    _fill_trace(file.create_group("trace", track_order=True), estimate.trace)
    if estimate.parameters is not None:
        fill_parameters(file.create_group("parameters"), estimate.parameters, result.parameters_true)
    curves = file.create_group("series", track_order=True)
    for series in estimate.series:
        fill_series(curves, series)
    if estimate.state:
        fill_state(file.create_group("continuation"), estimate.state)


def _fill_trace(group: h5py.Group, trace: dict[str, Array]) -> None:
    """Write the history; what has no known dimensions gets axes of its own."""
    passes = len(trace["loglik"]) if "loglik" in trace else 0
    add_index(group, "pass", passes, "pass over the data", first=1)
    group.attrs["shapes"] = json.dumps({name: np.shape(array) for name, array in trace.items()})
    for name, array in trace.items():
        shape = np.shape(array)
        tail, units, long_name = _VALUES.get(name, ((), "1", _TRACE.get(name, name)))
        dims = ["pass", *tail]
        if len(shape) != len(dims) or shape[0] != passes:
            dims = [f"{name}_axis_{k}" for k in range(len(shape))]
            for dim, length in zip(dims, shape, strict=True):
                if 0 not in shape:
                    add_index(group, dim, length, f"axis of {name}")
        put(group, name, array, dims, units, long_name)


def _result(file: h5py.File) -> UnitResult:
    names = {name: columns_of(file, name) for name in ("noise", "output", "state")}
    tests = labels_of(file, "test")
    sizes = {"test": len(tests)} | {name: len(columns) for name, columns in names.items()}
    text = {name: str(file.attrs[name]) for name in ("unit", "dataset", "method_label", "start_label")}
    truth = file["truth"]
    interval = float(file.attrs.get("noise_interval", math.nan))
    return UnitResult(
        **text,
        start_index=int(file.attrs["start_index"]),
        replicate=int(file.attrs["replicate"]),
        estimate=_estimate(file, sizes),
        evaluations={label: read_evaluation(group, sizes) for label, group in file["evaluation"].items()},
        noise_names=names["noise"],
        output_names=names["output"],
        state_names=names["state"],
        test_names=tests,
        Q_true=truth["Q"][()] if "Q" in truth else None,
        R_true=truth["R"][()] if "R" in truth else None,
        seconds=float(file["unit_seconds"][()]),
        seed=int(file.attrs["seed"]),
        held_out={label: read_evaluation(group, sizes) for label, group in file["held_out"].items()},
        held_out_tests=int(file.attrs["held_out_tests"]),
        parameters_true=parameter_values(file, "truth"),
        uncertainty=read_uncertainty(file),
        Q_tuning=file["tuning"]["Q"][()] if "tuning/Q" in file else None,
        R_tuning=file["tuning"]["R"][()] if "tuning/R" in file else None,
        density=bool(file.attrs.get("density", 0)),
        interval=None if math.isnan(interval) else interval,
    )


def _estimate(file: h5py.File, sizes: dict[str, int]) -> Estimate:
    shapes = json.loads(file["trace"].attrs["shapes"])
    return Estimate(
        method=str(file.attrs["method"]),
        status=str(file.attrs["status"]),  # type: ignore[arg-type]
        reason=str(file.attrs["reason"]),
        start=_values(file["start"], sizes),
        final=_values(file["final"], sizes),
        loglik_start=float(file["loglik_start"][()]),
        loglik=float(file["loglik"][()]),
        passes=int(file["passes"][()]),
        seconds=float(file["estimation_seconds"][()]),
        trace={name: get(file["trace"], name, tuple(shape)) for name, shape in shapes.items()},
        safeguards=tuple(json.loads(file.attrs["safeguards"])),
        settings=json.loads(file.attrs["settings"]),
        parameters=read_parameters(file),
        state=read_state(file),
        series=tuple(read_series(name, group) for name, group in file["series"].items()) if "series" in file else (),
    )


def _values(group: h5py.Group, sizes: dict[str, int]) -> NoiseValues:
    shapes = {name: tuple(sizes[dim.rstrip("_")] for dim in dims) for name, (dims, _, _) in _VALUES.items()}
    return NoiseValues(**{name: get(group, name, shape) for name, shape in shapes.items()})

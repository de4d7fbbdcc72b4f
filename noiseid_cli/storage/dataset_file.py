"""Dataset files: recordings of one model, with the truth behind them where it is known.

Format ``noiseid-dataset``, version 1. Tests of unequal length are padded with NaN up to the longest;
``length`` says how many samples count. A NaN before that is a missing measurement.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from noiseid_cli import __version__
from noiseid_cli.errors import DataError
from noiseid_cli.models.recording import Array, Dataset, Recording
from noiseid_cli.storage import hdf5
from noiseid_cli.storage.atomic import publish
from noiseid_cli.storage.layout import (
    Columns,
    add_columns,
    add_index,
    add_labels,
    columns_of,
    common_unit,
    get,
    in_words,
    labels_of,
    put,
)

if TYPE_CHECKING:
    import h5py

FORMAT = "noiseid-dataset"
VERSION = 1
MIGRATIONS: dict[int, hdf5.Migration] = {}
_TAKEN = frozenset({"format", "format_version", "title", "model", "inputs", "outputs", "created_by", "notes"})


def write_dataset(path: Path, dataset: Dataset, attributes: dict[str, str]) -> None:
    """Write ``dataset`` to ``path``, complete or not at all.

    Args:
        path: the file; what stood there is replaced.
        dataset: at least one test; every column of u, y, x and z has its name and unit.
        attributes: texts to keep with it, such as the resolved config and the provenance, as JSON.

    Raises:
        DataError: the dataset contradicts itself, or the file cannot be written.
    """
    _check(dataset)

    def fill(file: h5py.File) -> None:
        own = {
            "title": dataset.name,
            "model": dataset.model,
            "inputs": in_words(dataset.inputs),
            "outputs": in_words(dataset.outputs),
            "created_by": f"noiseid {__version__}",
            "notes": json.dumps(dataset.notes, ensure_ascii=False),
        }
        hdf5.set_attributes(file, own)
        hdf5.set_attributes(file, attributes, _TAKEN)
        _fill_dimensions(file, dataset)
        _fill_recordings(file, dataset)
        _fill_truth(file, dataset)

    publish(path, hdf5.build(FORMAT, VERSION, fill))


def read_dataset(path: Path) -> Dataset:
    """Read a dataset file, bit for bit what was written.

    Raises:
        DataError: the file is missing, damaged, of another kind or too new.
    """
    with hdf5.opened(path, FORMAT, VERSION, MIGRATIONS) as file:
        return _dataset(file)


def read_attributes(path: Path) -> dict[str, str]:
    """Read the texts kept with a dataset: those given to ``write_dataset`` and the format's own.

    Raises:
        DataError: as for ``read_dataset``.
    """
    with hdf5.opened(path, FORMAT, VERSION, MIGRATIONS) as file:
        return hdf5.text_attributes(file)


def read_size(path: Path) -> tuple[int, int, int, int]:
    """Samples of the longest test, number of tests, of inputs and of outputs, without reading the numbers.

    Raises:
        DataError: as for ``read_dataset``.
    """
    with hdf5.opened(path, FORMAT, VERSION, MIGRATIONS) as file:
        tests, samples = file["time"].shape
        return int(samples), int(tests), len(columns_of(file, "input")), len(columns_of(file, "output"))


def _check(dataset: Dataset) -> None:
    """Refuse a dataset that could not be read back as it is."""
    where = f"The dataset '{dataset.name}' cannot be written: "
    names = [test.name for test in dataset.recordings]
    if not names:
        raise DataError(where + "it has no recordings.")
    if len(set(names)) < len(names):
        raise DataError(where + "two of its tests have the same name.")
    for test in dataset.recordings:
        n = test.samples
        wanted = {
            "dt": (test.dt, (n - 1,)),
            "u": (test.u, (n, len(dataset.inputs))),
            "y": (test.y, (n, len(dataset.outputs))),
            "x_true": (test.x_true, (n, len(dataset.states))),
            "z_true": (test.z_true, (n, len(dataset.performances))),
            "parameters_true": (test.parameters_true, (n, len(dataset.parameters))),
        }
        for label, (array, shape) in wanted.items():
            if array is not None and array.shape != shape:
                raise DataError(
                    where + f"{label} of test '{test.name}' has shape {array.shape}; "
                    f"with the columns that the dataset names it must be {shape}."
                )


def _fill_dimensions(file: h5py.File, dataset: Dataset) -> None:
    add_labels(file, "test", [test.name for test in dataset.recordings], "test")
    add_index(file, "sample", max(test.samples for test in dataset.recordings), "number of the sample")
    add_columns(file, "input", dataset.inputs, "input")
    add_columns(file, "output", dataset.outputs, "measured output")
    put(
        file, "length", np.array([test.samples for test in dataset.recordings]), ["test"],
        long_name="number of samples of each test; the rest is padding",
    )  # fmt: skip


def _fill_recordings(file: h5py.File, dataset: Dataset) -> None:
    tests = dataset.recordings
    longest = max(test.samples for test in tests)
    plane = ["test", "sample"]
    put(file, "time", _padded([_clock(t) for t in tests], (longest,)), plane, "s", "time of each sample")
    interval = _padded([test.dt for test in tests], (longest,))
    put(file, "interval", interval, plane, "s", "interval to the next sample", "time")
    u = _padded([test.u for test in tests], (longest, len(dataset.inputs)))
    meaning = "input, held until the next sample"
    put(file, "u", u, [*plane, "input"], common_unit(dataset.inputs, "input"), meaning, _along("input"))
    y = _padded([test.y for test in tests], (longest, len(dataset.outputs)))
    meaning = "measured output; NaN is missing"
    put(file, "y", y, [*plane, "output"], common_unit(dataset.outputs, "output"), meaning, _along("output"))


def _along(dim: str) -> str:
    """The auxiliary coordinates of a variable whose columns are ``dim``, as CF names them."""
    return f"time {dim}_unit {dim}_description"


def _fill_truth(file: h5py.File, dataset: Dataset) -> None:
    truth = file.create_group("truth")
    add_columns(truth, "state", dataset.states, "state")
    add_columns(truth, "performance", dataset.performances, "performance output")
    add_columns(truth, "parameter", dataset.parameters, "model parameter")
    _fill_true_path(truth, "x", "state", dataset.states, [test.x_true for test in dataset.recordings])
    _fill_true_path(truth, "z", "performance", dataset.performances, [t.z_true for t in dataset.recordings])
    _fill_true_path(truth, "p", "parameter", dataset.parameters, [t.parameters_true for t in dataset.recordings])
    if dataset.Q_true is not None:
        for dim in ("noise", "noise_"):
            add_index(truth, dim, len(dataset.Q_true), "number of the process noise", first=1)
        long_name = "true covariance of the process noise, per sample"
        put(truth, "Q", dataset.Q_true, ["noise", "noise_"], "product of the noises' units", long_name)
    if dataset.R_true is not None:
        add_labels(truth, "output_", [column[0] for column in dataset.outputs], "measured output, again")
        long_name = "true covariance of the measurement noise"
        put(truth, "R", dataset.R_true, ["output", "output_"], "product of the outputs' units", long_name)


def _fill_true_path(truth: h5py.Group, name: str, dim: str, columns: Columns, paths: list[Array | None]) -> None:
    """Write the true states, performance outputs or parameters of the tests where they are known."""
    truth.attrs[f"{name}_known"] = np.array([path is not None for path in paths], dtype=np.int64)
    known = [path for path in paths if path is not None]
    if known:
        longest = len(truth.file["sample"]) if "sample" in truth.file else 0
        values = _padded(paths, (longest, len(columns)))
        long_name = "true performance output" if dim == "performance" else f"true {dim}"
        put(truth, name, values, ["test", "sample", dim], common_unit(columns, dim), long_name)


def _clock(test: Recording) -> Array:
    time = test.time.copy()
    time[:1] = test.start  # adding 0.0 would have lost the sign of a negative zero
    return time


def _padded(arrays: Sequence[Array | None], shape: tuple[int, ...]) -> Array:
    """(tests, *shape) values of all tests, NaN behind the end of each and where a test has none."""
    out = np.full((len(arrays), *shape), np.nan)
    for row, array in zip(out, arrays, strict=True):
        if array is not None:
            row[: len(array)] = array
    return out


def _dataset(file: h5py.File) -> Dataset:
    inputs, outputs = columns_of(file, "input"), columns_of(file, "output")
    truth = file["truth"]
    states, performances, parameters = (columns_of(truth, dim) for dim in ("state", "performance", "parameter"))
    names = labels_of(file, "test")
    lengths = file["length"][()]
    plane = (len(names), len(file["sample"]) if "sample" in file else 0)
    time, interval = get(file, "time", plane), get(file, "interval", plane)
    u, y = get(file, "u", (*plane, len(inputs))), get(file, "y", (*plane, len(outputs)))
    x = _truth(truth, "x", (*plane, len(states)))
    z = _truth(truth, "z", (*plane, len(performances)))
    p = _truth(truth, "p", (*plane, len(parameters)))
    tests = []
    for k, (name, n) in enumerate(zip(names, lengths, strict=True)):
        x_true, z_true, p_true = _first(x[k], n), _first(z[k], n), _first(p[k], n)
        dt, start = interval[k, : n - 1].copy(), float(time[k, 0])
        tests.append(Recording(name, dt, u[k, :n].copy(), y[k, :n].copy(), start, x_true, z_true, p_true))
    return Dataset(
        name=str(file.attrs["title"]),
        model=str(file.attrs["model"]),
        recordings=tuple(tests),
        inputs=inputs,
        outputs=outputs,
        states=states,
        performances=performances,
        parameters=parameters,
        Q_true=truth["Q"][()] if "Q" in truth else None,
        R_true=truth["R"][()] if "R" in truth else None,
        notes=tuple(json.loads(file.attrs["notes"])),
    )


def _truth(truth: h5py.Group, name: str, shape: tuple[int, ...]) -> list[Array | None]:
    known = truth.attrs.get(f"{name}_known", [False] * shape[0])  # files before parameters could change have no p
    if not any(known):
        return [None] * len(known)
    values = get(truth, name, shape)
    return [values[k] if known[k] else None for k in range(len(known))]


def _first(values: Array | None, n: int) -> Array | None:
    return None if values is None else values[:n].copy()

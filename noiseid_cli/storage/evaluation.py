"""How a filter agrees with data, as a group of a result file."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from noiseid_cli.diagnostics.evaluation import Evaluation
from noiseid_cli.errors import DataError
from noiseid_cli.storage.layout import add_index, get, put
from noiseid_cli.storage.misfit import fill_misfits, read_misfits

if TYPE_CHECKING:
    import h5py

_VARIABLES: dict[str, tuple[tuple[str, ...], str]] = {
    "loglik": ((), "log-likelihood"),
    "observed": ((), "number of scalar measurements used"),
    "nis": ((), "mean normalised innovation squared per scalar measurement; 1 if consistent"),
    "nis_output": (("output",), "mean squared normalised innovation per output; 1 if consistent"),
    "autocorrelation": (("lag", "output"), "autocorrelation of the normalised innovations"),
    "ljung_box": (("output",), "p-value of the Ljung-Box test of whiteness"),
    "kurtosis": (("output",), "excess kurtosis of the normalised innovations"),
    "path_error": (("sample",), "distance between estimated and true performance output"),
    "path_error_norm": ((), "2-norm over time of the path error; NaN where no truth is known"),
    "nis_time": (("sample",), "normalised innovation squared per measurement"),
    "inside": (("output",), "share of innovations within their band of 95 %"),
    "normality": (("output",), "p-value of the test of Jarque and Bera"),
    "nees": ((), "mean normalised estimation error squared per state; NaN where no truth is known"),
    "nees_time": (("sample",), "normalised estimation error squared per state"),
    "states": ((), "number of states"),
}
_OPTIONAL = ("path_error", "inside", "normality", "nees_time")
_PATH = "the performance output's unit"


def fill_evaluation(parent: h5py.Group, label: str, evaluation: Evaluation) -> None:
    """Write an evaluation as a group of its own.

    Raises:
        DataError: its label cannot be the name of a group.
    """
    if not label.isidentifier():
        raise DataError(f"An evaluation cannot be labelled {label!r}: a label is letters, digits and underscores.")
    group = parent.create_group(label)
    group.attrs["label"] = evaluation.label
    group.attrs["filter"] = evaluation.filter
    add_index(group, "lag", len(evaluation.autocorrelation), "lag in samples", first=1)
    add_index(group, "sample", len(evaluation.nis_time), "number of the sample, all tests one after the other")
    for name in _OPTIONAL:
        group.attrs[f"has_{name}"] = int(getattr(evaluation, name) is not None)
    for name, (dims, long_name) in _VARIABLES.items():
        values = getattr(evaluation, name)
        if values is not None:
            put(group, name, values, dims, _PATH if name.startswith("path") else "1", long_name)
    fill_misfits(group, evaluation.misfit)


def read_evaluation(group: h5py.Group, sizes: dict[str, int]) -> Evaluation:
    """Read what ``fill_evaluation`` wrote; ``sizes`` are those of the file's own dimensions."""
    here = sizes | {dim: len(group[dim]) if dim in group else 0 for dim in ("lag", "sample")}
    arrays = {
        name: None if name in _OPTIONAL and not group.attrs.get(f"has_{name}", 0)
        else get(group, name, tuple(here[dim] for dim in dims))
        for name, (dims, _) in _VARIABLES.items() if dims
    }  # fmt: skip
    return Evaluation(
        label=str(group.attrs["label"]),
        filter=str(group.attrs.get("filter", "extended")),
        loglik=float(group["loglik"][()]),
        observed=int(group["observed"][()]),
        nis=float(group["nis"][()]),
        path_error_norm=float(group["path_error_norm"][()]),
        nees=float(group["nees"][()]) if "nees" in group else math.nan,
        states=int(group["states"][()]) if "states" in group else 0,
        misfit=read_misfits(group),
        **arrays,  # type: ignore[arg-type]
    )

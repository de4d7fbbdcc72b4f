"""An estimate in a form for other programs: the matrices with their names, units and conventions as plain data."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from noiseid_cli.errors import DataError
from noiseid_cli.models.recording import Array
from noiseid_cli.outcome import Columns, UnitResult
from noiseid_cli.storage.result_file import read_result, read_result_attributes

FORMAT = "noiseid-export"
VERSION = 1

_HELD = (
    "per sample: the covariance of a noise that is held over each sampling interval. For another sample time T, "
    "multiply by sample_time.median / T."
)
_DISCRETE = "per sample: the covariance of the noise in one step of the discrete model. It goes with this sample time."
_DENSITY = "two-sided density, in products of the units: divide by the sample time to get the covariance per sample."
_R = "covariance of the measurement noise of one sample"
_M0 = "mean of the first state of each test, before its first measurement"
_P0 = "covariance of the first state, before its first measurement, the same for all tests"


def read_exported(path: Path) -> dict[str, Any]:
    """What is exported of a result file.

    Args:
        path: the result.

    Returns:
        Plain data: texts, numbers, lists of them; None where a number is not known.

    Raises:
        DataError: the file is missing, damaged, or older than exports.
    """
    result, attributes = read_result(path), read_result_attributes(path)
    if "model" not in attributes:
        raise DataError(f"{path} does not say which model it belongs to: make it anew with `noiseid estimate --force`")
    return exported(result, attributes)


def exported(result: UnitResult, attributes: dict[str, str]) -> dict[str, Any]:
    """The same of a result in memory, with the texts that are kept with it."""
    config, model = json.loads(attributes["config"]), json.loads(attributes["model"])
    estimate, final, section = result.estimate, result.estimate.final, config["estimate"]
    per_sample = _DISCRETE if model["discretisation"] == "discrete" else _HELD
    means = dict(zip(result.test_names, final.m0.tolist(), strict=True))
    data = {
        "format": FORMAT,
        "format_version": VERSION,
        "experiment": config["experiment"],
        "result": result.unit,
        "method": estimate.method,
        "status": estimate.status,
        "reason": estimate.reason,
        "log_likelihood": estimate.loglik,
        "sample_time": json.loads(attributes["sample_time"]),
        "Q": _covariance(
            final.Q, result.noise_names, _DENSITY if result.density else per_sample, section["process_noise"]
        ),
        "R": _covariance(final.R, result.output_names, _R, section["measurement_noise"]),
        "m0": _names(result.state_names, _M0, section["initial_mean"]) | {"tests": means},
        "P0": _covariance(final.P0, result.state_names, _P0, section["initial_covariance"]),
        "parameters": _parameters(result, model["parameters"]),
        "model": {"name": model["name"], "discretisation": model["discretisation"]},
        "provenance": {
            "result_key": attributes["key"],
            "model_sha256": attributes["model_sha256"],
            "seed": result.seed,
            **json.loads(attributes["provenance"]),
        },
    }
    finite: dict[str, Any] = _finite(data)
    return finite


def _names(columns: Columns, meaning: str, choice: dict[str, Any]) -> dict[str, Any]:
    return {
        "meaning": meaning,
        "estimated": "start" in choice,
        "names": [name for name, _, _ in columns],
        "units": [unit for _, unit, _ in columns],
    }


def _covariance(matrix: Array, columns: Columns, meaning: str, choice: dict[str, Any]) -> dict[str, Any]:
    std = [math.sqrt(variance) for variance in matrix.diagonal().tolist()]
    return _names(columns, meaning, choice) | {"standard_deviations": std, "covariance": matrix.tolist()}


def _parameters(result: UnitResult, model: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The model's parameters, those that were estimated with the value found; then other scalars that were."""
    found = result.estimate.parameters
    rows = {p["name"]: p | {"estimated": False, "standard_error": None} for p in model}
    if found is not None:
        errors = [math.nan] * len(found.names) if found.standard_errors is None else found.standard_errors.tolist()
        for (name, unit, _), value, error in zip(found.names, found.final.tolist(), errors, strict=True):
            rows[name] = {"name": name, "value": value, "unit": unit, "estimated": True, "standard_error": error}
    return list(rows.values())


def _finite(data: Any) -> Any:
    """What is no finite number becomes None, which every format can write."""
    if isinstance(data, float):
        return data if math.isfinite(data) else None
    if isinstance(data, dict):
        return {key: _finite(value) for key, value in data.items()}
    return [_finite(value) for value in data] if isinstance(data, list) else data

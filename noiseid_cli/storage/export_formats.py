"""The formats of an export: YAML and JSON as nested data; MAT and npz as named arrays, with all of it as text."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from typing import Any

_HEADER = """\
# Noise of a state-space model, identified by noiseid. Each covariance stands with its names, units and meaning;
# `estimated: false` marks what was given and not found.
"""
_MAT_HEADER = b"MATLAB 5.0 MAT-file, written by noiseid"


def _yaml(data: dict[str, Any]) -> bytes:
    import yaml

    text = yaml.safe_dump(data, sort_keys=False, allow_unicode=True, default_flow_style=None, width=110)
    return (_HEADER + text).encode()


def _json(data: dict[str, Any]) -> bytes:
    return (json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False) + "\n").encode()


def _flat(data: dict[str, Any]) -> dict[str, Any]:
    """Arrays and lists of texts by name, and everything as JSON text under ``about``."""
    import numpy as np

    def numbers(values: Any) -> Any:
        return np.array(values, dtype=np.float64)  # None becomes NaN

    rows = data["parameters"]
    flat: dict[str, Any] = {name: numbers(data[name]["covariance"]) for name in ("Q", "R", "P0")}
    flat |= {
        "m0": numbers(list(data["m0"]["tests"].values())),
        "tests": list(data["m0"]["tests"]),
        "sample_time": numbers(data["sample_time"]["median"]),
        "parameters": numbers([row["value"] for row in rows]),
        "parameters_standard_errors": numbers([row["standard_error"] for row in rows]),
        "parameters_names": [row["name"] for row in rows],
        "parameters_units": [row["unit"] for row in rows],
        "about": json.dumps(data, ensure_ascii=False, allow_nan=False),
    }
    for name in ("Q", "R", "m0", "P0"):
        flat |= {f"{name}_names": data[name]["names"], f"{name}_units": data[name]["units"]}
    return flat


def _npz(data: dict[str, Any]) -> bytes:
    import numpy as np

    memory = io.BytesIO()
    arrays: dict[str, Any] = {
        name: np.array(v, dtype=np.str_) if isinstance(v, list) else v for name, v in _flat(data).items()
    }
    np.savez(memory, **arrays)
    return memory.getvalue()


def _mat(data: dict[str, Any]) -> bytes:
    import numpy as np
    from scipy.io import savemat

    def cells(texts: list[str]) -> Any:
        out = np.empty((len(texts), 1), dtype=object)
        out[:, 0] = texts
        return out

    memory: Any = io.BytesIO()
    savemat(memory, {name: cells(v) if isinstance(v, list) else v for name, v in _flat(data).items()}, oned_as="column")
    # scipy writes the time into the header, 116 bytes of free text: the same result is to give the same bytes.
    written: bytes = memory.getvalue()
    return _MAT_HEADER.ljust(116) + written[116:]


FORMATS: dict[str, Callable[[dict[str, Any]], bytes]] = {"yaml": _yaml, "json": _json, "mat": _mat, "npz": _npz}
"""What writes each format, by its name, which is the ending of the file too."""

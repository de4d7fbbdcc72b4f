"""Keys: the hash of everything that a file depends on, which is part of its name."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from noiseid_cli.pipeline.context import Context

# Raised by hand when a stage's meaning changes, so that old files are made anew.
STAGE_VERSION = {"simulate": 1, "import": 1, "estimate": 1, "report": 1}


def digest(stage: str, *parts: Any) -> str:
    """Key of what a stage makes from these parts, which are JSON data: 64 hexadecimal digits."""
    text = json.dumps([stage, STAGE_VERSION[stage], *parts], sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def unit_path(context: Context, kind: str, name: str, key: str) -> Path:
    """File of a unit: ``<folder>/<kind>/<name>-<first digits of the key>.h5``.

    The points of a sweep share their names, so that only the digits keep their files apart: there are more of them.
    """
    digits = 8 if context.base is None else 16
    return context.folder / kind / f"{name}-{key[:digits]}.h5"

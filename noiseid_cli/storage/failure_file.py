"""What is left of a unit that failed: a record beside the place of its file, until the unit succeeds.

The record is for people and for `noiseid status`. Nothing is decided by it: a unit without a file is to be done.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from noiseid_cli import __version__
from noiseid_cli.storage.atomic import publish

FORMAT = "noiseid-failure"
VERSION = 1
_LARGEST = 1 << 20  # bytes; a larger file is not one of ours


@dataclass(frozen=True)
class Failure:
    """Why a unit has no file.

    Attributes:
        unit: label of the unit.
        reason: what went wrong, and what to do about it.
        tries: how often it was tried, all runs together.
        at: when it failed last, UTC.
    """

    unit: str
    reason: str
    tries: int
    at: str


def failure_path(path: Path) -> Path:
    """Where the failure of the unit with the file ``path`` is recorded: ``x.failed.json`` beside ``x.h5``."""
    return path.with_name(f"{path.name.removesuffix('.h5')}.failed.json")


def record_failure(path: Path, unit: str, reason: str, tries: int, key: str, config: dict[str, Any]) -> None:
    """Record that a unit failed, once more.

    Args:
        path: the file that it did not make.
        unit: label of the unit.
        reason: what went wrong.
        tries: how often it was tried in this run.
        key: the unit's key.
        config: the resolved settings, so that it can be tried elsewhere.

    Raises:
        DataError: the record cannot be written.
    """
    before = read_failure(path)
    record = {
        "format": FORMAT,
        "format_version": VERSION,
        "unit": unit,
        "reason": reason,
        "tries": tries + (before.tries if before else 0),
        "at": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "key": key,
        "noiseid": __version__,
        "config": config,
    }
    publish(failure_path(path), json.dumps(record, indent=1, ensure_ascii=False).encode("utf-8", "backslashreplace"))


def read_failure(path: Path) -> Failure | None:
    """The failure of the unit with the file ``path``; None where there is no record that can be read."""
    try:
        with failure_path(path).open("rb") as file:
            data = json.loads(file.read(_LARGEST))
        if data["format"] != FORMAT or data["format_version"] > VERSION:
            return None
        return Failure(str(data["unit"]), str(data["reason"]), int(data["tries"]), str(data["at"]))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def forget_failure(path: Path) -> None:
    """Remove the record of a unit that has succeeded by now."""
    failure_path(path).unlink(missing_ok=True)

"""Which columns of a log look like inputs and which like outputs, by their names and by their values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from noiseid_cli.recordings.survey import ColumnFacts, Survey
from noiseid_cli.recordings.table import Key
from noiseid_cli.recordings.time_column import TimeFound, words_of

_KINDS = {
    "effort": "u tau torque force f moment current amp amps voltage volt volts pwm thrust throttle valve",
    "command": "cmd command commanded input in control ctrl act action actuator",
    "wish": "des desired ref reference setpoint target goal sp",
    "position": "pos position angle q theta phi psi x y z alpha beta enc encoder height level distance roll pitch yaw",
    "speed": "vel velocity speed rate dq dx dtheta dphi omega w qd qdot",
    "sensor": "acc accel acceleration accelerometer gyro imu pressure temperature temp",
    "other": "meas measured measurement out output sensor raw",
}
_KIND_OF = {word: kind for kind, words in _KINDS.items() for word in words.split()}
_STRENGTH = ("wish", "command", "effort", "sensor", "speed", "position", "other")
_AXES = ("x", "y", "z")
Role = Literal["input", "output", "left out"]


@dataclass(frozen=True)
class ColumnRole:
    """What a column is taken for.

    Attributes:
        key: the column.
        role: input, output, or left out.
        why: what tells it.
    """

    key: Key
    role: Role
    why: str


def kind_of(name: Key) -> str:
    """What a name speaks of: one of ``_KINDS``; empty if it has no word of theirs."""
    kinds = [_KIND_OF[word] for word in words_of(name) if word in _KIND_OF]
    return next((kind for kind in _STRENGTH if kind in kinds), "")


def label_of(name: Key) -> tuple[str, ...]:
    """What tells columns of one kind apart: numbers, axes and words that are not known."""
    words = words_of(name)
    return tuple(word for word in words if word not in _KIND_OF or (word in _AXES and len(words) > 1))


def find_roles(found: Survey, time: TimeFound) -> tuple[ColumnRole, ...]:
    """The role of every column but the time, in the order of the file."""
    columns = [column for column in found.columns if column.key != time.key]
    return tuple(_role(column, columns, found, time) for column in columns)


def _role(column: ColumnFacts, columns: list[ColumnFacts], found: Survey, time: TimeFound) -> ColumnRole:
    key, kind = column.key, kind_of(column.key)
    if why := _useless(column) or _copied(column, columns, found, time) or _unwanted(key, kind, columns):
        return ColumnRole(key, "left out", why)
    if kind in ("effort", "command"):
        return ColumnRole(key, "input", "by its name")
    if not kind and column.held > 0.5 and _jumps(column):
        return ColumnRole(key, "input", "it holds its value and then jumps, as commands do")
    return ColumnRole(key, "output", "by its name" if kind else "nothing in its name or values says input")


def _useless(column: ColumnFacts) -> str:
    """Why a column tells nothing; empty if it may."""
    if column.constant:
        return "it never changes"
    if column.bad + column.missing > 0.9 * len(column.values):
        return "nine cells in ten hold no number"
    return "it only rises evenly, like a clock or a counter" if _is_clock(column) else ""


def _copied(column: ColumnFacts, columns: list[ColumnFacts], found: Survey, time: TimeFound) -> str:
    """From which other column it was computed; empty if from none."""
    others = (c for c in columns if c is not column and _is_difference(column.values, c.values, found, time))
    source = next(others, None)
    return "" if source is None else f"it is the backward difference of {source.key}, no second sensor"


def _unwanted(key: Key, kind: str, columns: list[ColumnFacts]) -> str:
    """Why a column of that name is best left out; empty if it is not."""
    if kind == "wish":
        return "its name says that it is what was wished for, not what was measured"
    partner = [c.key for c in columns if kind_of(c.key) == "position" and label_of(c.key) == label_of(key)]
    if kind == "speed" and partner:
        return f"speeds beside a position ({partner[0]}) are mostly computed from it; make it an output if not"
    return ""


def _is_clock(column: ColumnFacts) -> bool:
    steps = np.diff(column.known)
    return bool(np.all(steps >= 0.0)) and float(np.std(steps)) < 0.2 * float(np.mean(steps))


def _jumps(column: ColumnFacts) -> bool:
    """Where it changes it changes by more than a tenth of its range, in the middle."""
    steps = np.abs(np.diff(column.known))
    return bool(np.median(steps[steps > 0.0]) > 0.1 * np.ptp(column.known))


def _is_difference(values: np.ndarray, other: np.ndarray, found: Survey, time: TimeFound) -> bool:
    """Values that equal the backward difference of another column over its interval, but for one row in fifty."""
    dt = time.interval if time.key is None else time.scale * np.diff(found.column(time.key).values)
    with np.errstate(divide="ignore", invalid="ignore"):
        difference = np.diff(other) / dt
    both = np.isfinite(difference) & np.isfinite(values[1:])
    if both.sum() < 10 or not np.any(difference[both]):
        return False
    size = np.median(np.abs(values[1:][both])) + np.median(np.abs(difference[both]))
    return size > 0.0 and bool(np.mean(np.abs(values[1:] - difference)[both] <= 0.01 * size) > 0.98)

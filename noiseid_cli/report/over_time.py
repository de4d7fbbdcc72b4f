"""What an online method estimated over time, read from its curves: one track for each unknown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from noiseid_cli.estimators.estimate import Series
from noiseid_cli.models.recording import Array
from noiseid_cli.outcome import UnitResult
from noiseid_cli.report.reading import group
from noiseid_cli.report.study import Study

INTO_HOLD = 1.0
"""Time from the begin of a hold after which drift counts, s: until then the motion still fades."""


@dataclass(frozen=True)
class Track:
    """One unknown of one unit over time.

    Attributes:
        name, unit: of the unknown.
        at: (n,) time, s.
        values: (n,) estimates.
        std: (n,) their standard deviations; NaN where the method gives none.
        truth: (n,) true values; NaN where they are not known.
        gate: (n,) whether the method adapts the unknown there; all True for a method that always does.
    """

    name: str
    unit: str
    at: Array
    values: Array
    std: Array
    truth: Array
    gate: np.ndarray

    @property
    def error(self) -> Array:
        """(n,) relative error; NaN where the truth is zero or not known."""
        scale = np.where(self.truth == 0, np.nan, np.abs(self.truth))
        found: Array = (self.values - self.truth) / scale
        return found


def series(result: UnitResult, name: str) -> Series | None:
    """Curves of a unit by name, where it has them; one that diverged at the first sample has none."""
    return next((s for s in result.estimate.series if s.name == name and len(s.at)), None)


def online(study: Study) -> list[UnitResult]:
    """The units whose estimates move over time."""
    return [r for r in study.results if over_time(r)]


def over_time(result: UnitResult) -> bool:
    """Whether a unit's estimates move over time."""
    found = series(result, "parameters")
    return found is not None and found.axis[1] == "s"


def drawn(study: Study) -> list[UnitResult]:
    """One unit of each online method, of the first dataset and start."""
    units = online(study)
    return [same[0] for same in group(units, lambda r: r.method_label).values()]


def track(result: UnitResult, name: str) -> Track | None:
    """One unknown of a unit over time; None where the unit does not estimate it."""
    found = series(result, "parameters")
    names = [] if found is None else [column[0] for column in found.columns]
    if found is None or name not in names:
        return None
    i = names.index(name)
    nothing = np.full(len(found.at), np.nan)
    gate = _curve(result, "open", name)
    std = _curve(result, "parameters_std", name)
    truth = _curve(result, "parameters_true", name)
    return Track(
        name=name,
        unit=found.columns[i][1],
        at=found.at,
        values=found.values[:, i],
        std=nothing if std is None else std,
        truth=np.full(len(found.at), _constant_truth(result, name)) if truth is None else truth,
        gate=np.ones(len(found.at), dtype=bool) if gate is None else gate > 0.5,
    )


def tracked_names(units: list[UnitResult]) -> list[str]:
    """Every unknown that one of the units estimates over time, in order of appearance."""
    found = [s for r in units if (s := series(r, "parameters")) is not None]
    return list(dict.fromkeys(name for s in found for name, _, _ in s.columns))


def is_variance(result: UnitResult, name: str) -> bool:
    """Whether an unknown is the variance of the process noise of that name."""
    return name in [noise for noise, _, _ in result.noise_names]


def change_times(units: list[UnitResult]) -> list[float]:
    """Times at which a true parameter jumps, s; points less than a hundredth of the time apart count as one."""
    times: list[float] = []
    for r in units[:1]:
        truth = series(r, "parameters_true")
        if truth is None:
            continue
        jumps = truth.at[1:][(np.diff(truth.values, axis=0) != 0).any(axis=1)]
        for t in jumps.tolist():
            if not times or t - times[-1] > 0.01 * float(np.ptp(truth.at)):
                times.append(t)
    return times


def spans(flags: np.ndarray, at: Array) -> list[tuple[float, float]]:
    """Stretches of the axis in which a flag is set, from its first point to the first one after it."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False])).astype(int)))
    last = len(at) - 1
    return [(float(at[a]), float(at[min(b, last)])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def held(study: Study, result: UnitResult) -> tuple[float, float] | None:
    """Begin and end of the time in which the motion of a unit's data is held, s; None where the curves miss it."""
    data, found = study.dataset(result.dataset), series(result, "parameters")
    if data is None or data.held is None or found is None:
        return None
    return data.held if in_hold(found.at, data.held).any() else None


def in_hold(at: Array, hold: tuple[float, float]) -> np.ndarray:
    """Which points lie in a hold, from where the motion before it has faded."""
    flags: np.ndarray = (at >= hold[0] + INTO_HOLD) & (at <= hold[1])
    return flags


def _curve(result: UnitResult, which: str, name: str) -> Array | None:
    found = series(result, which)
    names = [] if found is None else [column[0] for column in found.columns]
    base = series(result, "parameters")
    if found is None or base is None or name not in names or len(found.at) != len(base.at):
        return None
    return found.values[:, names.index(name)]


def _constant_truth(result: UnitResult, name: str) -> float:
    """True value of a parameter, or true variance of the noise of that name; NaN where it is not known."""
    names = [] if result.estimate.parameters is None else [n for n, _, _ in result.estimate.parameters.names]
    noises = [n for n, _, _ in result.noise_names]
    if result.parameters_true is not None and name in names:
        return float(result.parameters_true[names.index(name)])
    if result.Q_true is not None and name in noises:
        return float(np.diag(result.Q_true)[noises.index(name)])
    return float("nan")

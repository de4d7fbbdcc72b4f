"""How well online methods track their unknowns: error over noise seeds, time to settle, drift in a hold."""

from __future__ import annotations

import statistics
from collections.abc import Callable

import numpy as np

from noiseid_cli.outcome import UnitResult
from noiseid_cli.report.over_time import (
    INTO_HOLD,
    Track,
    change_times,
    held,
    in_hold,
    is_variance,
    online,
    track,
    tracked_names,
)
from noiseid_cli.report.reading import converged, group
from noiseid_cli.report.study import Study
from noiseid_cli.report.tables import Cell, Column, Missing, Table, number

LAST_SHARE = 0.25
"""Share of the time, at its end, over which bias and RMSE are taken."""

BAND = 0.1
"""Relative error within which an estimate counts as settled."""

_UNKNOWN_TRUTH = "The truth is zero or not known"


def tracking_table(study: Study) -> Table | None:
    """Bias, RMSE and settling time of each unknown of each method over the seeds; None without online methods."""
    units = online(study)
    if not units:
        return None
    begins = [0.0, *change_times(units)][:3]
    settle = [Column("Settled" if t == 0 else f"Settled from {t:.4g} s on", "s", digits=3) for t in begins]
    columns = (
        Column("Method"), Column("Unknown"), Column("Truth"), Column("In"), Column("Seeds"),
        Column("Bias", "%", decimals=2), Column("± Monte Carlo", "%", decimals=2), Column("RMSE", "%", decimals=2),
        *settle,
    )  # fmt: skip
    rows = []
    for method, same in group(units, lambda r: r.method_label).items():
        for name in tracked_names(same):
            tracks = _tracks(same, name)
            rows.append((method, name, *_tracking_cells(tracks, begins, len(same))))
    caption = (
        f"Relative to the truth, over the last {LAST_SHARE:.0%} of the time and over the seeds that converged. Bias: "
        "mean of the error; RMSE: root mean square of it over time and seeds. Settled: median over the seeds of the "
        f"time after which the error stays within {BAND:.0%}"
        + (", until the true parameters change" if len(begins) > 1 else "")
        + "; a seed that does not stay there counts as later than all others."
    )
    return Table("tracking", "Unknowns over time: error and time to settle", caption, columns, tuple(rows), 2)


def _tracks(units: list[UnitResult], name: str) -> list[Track]:
    return [t for r in units if converged(r) and (t := track(r, name)) is not None]


def _tracking_cells(tracks: list[Track], begins: list[float], total: int) -> tuple[Cell, ...]:
    if not tracks:
        none = Missing("No seed converged")
        return (none, none, f"0 / {total}", none, none, none, *(none for _ in begins))
    biases = [float(np.mean(late_errors(t))) for t in tracks]
    squares = [float(np.mean(late_errors(t) ** 2)) for t in tracks]
    n = len(tracks)
    spread = statistics.stdev(biases) / n**0.5 if n > 1 and np.isfinite(biases).all() else float("nan")
    ends = [*begins[1:], np.inf]
    settled = (_settling_cell(tracks, a, b) for a, b in zip(begins, ends, strict=True))
    return (
        number(float(tracks[0].truth[-1]), "The truth is not known"),
        tracks[0].unit or "1",
        f"{n} / {total}",
        number(100 * float(np.mean(biases)), _UNKNOWN_TRUTH),
        number(100 * spread, _UNKNOWN_TRUTH if n > 1 else "Fewer than two seeds converged"),
        number(100 * float(np.mean(squares)) ** 0.5, _UNKNOWN_TRUTH),
        *settled,
    )


def late_errors(t: Track) -> np.ndarray:
    """Relative errors over the last part of the time; NaN where the truth is zero or not known."""
    late: np.ndarray = t.error[t.at >= t.at[-1] - LAST_SHARE * (t.at[-1] - t.at[0])]
    return late


def settling_time(t: Track, begin: float = 0.0, end: float = np.inf) -> float:
    """Time from ``begin`` after which the error stays within the band until ``end``, s; infinite if it does not."""
    inside = (t.at >= begin) & (t.at < end)
    at, error = t.at[inside], np.abs(t.error[inside])
    if not len(at) or np.isnan(error).all():
        return float("nan")
    outside = np.flatnonzero(~(error <= BAND))
    if not len(outside):
        return 0.0
    return float(at[outside[-1] + 1] - begin) if outside[-1] + 1 < len(at) else float("inf")


def _settling_cell(tracks: list[Track], begin: float, end: float) -> Cell:
    times = [settling_time(t, begin, end) for t in tracks]
    if np.isnan(times).any():
        return Missing(_UNKNOWN_TRUTH)
    return number(statistics.median(times), f"Half of the seeds or more do not stay within {BAND:.0%}")


def hold_table(study: Study) -> Table | None:
    """What each unknown does while the motion is held, and how fast it is back; None where nothing is held."""
    units = [r for r in online(study) if held(study, r) is not None]
    if not units:
        return None
    columns = (
        Column("Method"), Column("Unknown"), Column("Seeds"), Column("Adapted", "%", decimals=1),
        Column("Moved / truth, median"), Column("Spread / truth"), Column("Moved less"),
        Column("Largest / truth, min"), Column("Largest / truth, max"),
        Column("Settled after the hold", "s", digits=3),
    )  # fmt: skip
    rows = []
    for method, same in group(units, lambda r: r.method_label).items():
        for name in tracked_names(same):
            used = [(t, h) for r in same if converged(r) and (t := track(r, name)) and (h := held(study, r))]
            rows.append((method, name, f"{len(used)} / {len(same)}", *_hold_cells(used)))
    caption = (
        f"Over the hold from {INTO_HOLD:g} s into it, per seed. Adapted: share of that time in which the method adapts "
        "the unknown. Moved: largest less smallest estimate. Spread: standard deviation over the seeds of the estimate "
        "with which that time begins; moved less: seeds that move by less than that. Largest: largest magnitude of the "
        f"estimate. Settled: median time from the end of the hold after which the error stays within {BAND:.0%}."
    )
    return Table("hold", "Unknowns while the motion is held", caption, columns, tuple(rows), 2)


def _hold_cells(used: list[tuple[Track, tuple[float, float]]]) -> tuple[Cell, ...]:
    if not used:
        return (Missing("No seed converged"),) * 7
    adapted = [float(np.mean(t.gate[in_hold(t.at, h)])) for t, h in used]
    moved, largest = ([read(t, h) for t, h in used] for read in (_moved, _largest))
    back = [settling_time(t, h[1]) for t, h in used]
    first = [_over_truth(t, h, lambda values: values[0]) for t, h in used]
    spread = statistics.stdev(first) if len(first) > 1 and np.isfinite(first).all() else float("nan")
    unknown = _UNKNOWN_TRUTH if len(first) > 1 else "Fewer than two seeds converged"
    return (
        100 * statistics.fmean(adapted),
        number(statistics.median(moved), _UNKNOWN_TRUTH),
        number(spread, unknown),
        Missing(unknown) if np.isnan(spread) else f"{sum(m < spread for m in moved)} / {len(moved)}",
        number(min(largest), _UNKNOWN_TRUTH),
        number(max(largest), _UNKNOWN_TRUTH),
        Missing(_UNKNOWN_TRUTH)
        if np.isnan(back).any()
        else number(statistics.median(back), f"Half of the seeds or more do not stay within {BAND:.0%}"),
    )


def _moved(t: Track, hold: tuple[float, float]) -> float:
    return _over_truth(t, hold, np.ptp)


def _largest(t: Track, hold: tuple[float, float]) -> float:
    return _over_truth(t, hold, lambda values: np.abs(values).max())


def _over_truth(t: Track, hold: tuple[float, float], read: Callable[[np.ndarray], float]) -> float:
    inside = in_hold(t.at, hold)
    truth = abs(float(t.truth[inside][-1]))
    return float(read(t.values[inside])) / truth if truth > 0 else float("nan")


def tracking_sentences(study: Study) -> list[str]:
    """What was found, method by method: the worst bias, the worst drift while the motion is held."""
    out = []
    for method, same in group(online(study), lambda r: r.method_label).items():
        used = [r for r in same if converged(r)]
        if not used:
            out.append(f"{method}: none of {len(same)} seeds converged.")
            continue
        out += _bias_sentences(method, used)
        out += _hold_sentence(study, method, used)
    return out


def _bias_sentences(method: str, used: list[UnitResult]) -> list[str]:
    """The worst parameter, and where each variance ends: variances are the harder ones and would drown the rest."""
    out = []
    biases = {name: _bias(_tracks(used, name)) for name in tracked_names(used)}
    known = {name: bias for name, bias in biases.items() if np.isfinite(bias)}
    parameters = {name: bias for name, bias in known.items() if not is_variance(used[0], name)}
    if parameters:
        worst = max(parameters, key=lambda name: abs(parameters[name]))
        small = sum(abs(bias) <= BAND for bias in parameters.values())
        out.append(
            f"{method}: {small} of {len(parameters)} parameters end within {BAND:.0%} of the truth on average over "
            f"{_seeds(len(used))}; the largest bias is {100 * parameters[worst]:+.3g} %, of {worst}."
        )
    variances = [f"that of {name} at {1 + known[name]:.3g} times" for name in known if name not in parameters]
    if variances:
        out.append(f"{method}: of the variances, {', '.join(variances)} its truth on average.")
    return out


def _bias(tracks: list[Track]) -> float:
    return float(np.mean([np.mean(late_errors(t)) for t in tracks]))


def _hold_sentence(study: Study, method: str, used: list[UnitResult]) -> list[str]:
    """The parameter that drifts furthest while the motion is held."""
    drifts: dict[str, list[float]] = {}
    for name in (name for name in tracked_names(used) if not is_variance(used[0], name)):
        pairs = [(t, h) for r in used if (t := track(r, name)) and (h := held(study, r))]
        found = [_largest(t, h) for t, h in pairs]
        if found and np.isfinite(found).all():
            drifts[name] = found
    if not drifts:
        return []
    worst = max(drifts, key=lambda name: max(drifts[name]))
    low, high = min(drifts[worst]), max(drifts[worst])
    reach = f"{low:.3g} times its truth" if len(used) == 1 else f"{low:.3g} to {high:.3g} times its truth"
    return [f"{method}: while the motion is held, {worst} reaches {reach} ({_seeds(len(used))})."]


def _seeds(n: int) -> str:
    return "1 seed" if n == 1 else f"{n} seeds"

"""The time axis of a recording: repeated and backward stamps, gaps, unequal intervals."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from noiseid_cli.models.recording import Array
from noiseid_cli.recordings.cells import Indices, Series
from noiseid_cli.recordings.faults import Findings, counted
from noiseid_cli.recordings.options import ProblemPolicy

_MAX_FILL = 10  # times the recorded rows


def order_stamps(series: Series, policy: ProblemPolicy, findings: Findings) -> Series:
    """Leave rows with strictly rising time; what else there is becomes a fault or a note."""
    if len(series.time) < 2:
        return series
    latest = np.maximum.accumulate(series.time)
    before = np.concatenate(([-np.inf], latest[:-1]))
    repeated, backward = series.time == before, series.time < before
    rising = ~(repeated | backward)
    leader = np.maximum.accumulate(np.where(rising, np.arange(len(rising)), 0))
    if policy.repeated_stamp == "error":
        for k in np.flatnonzero(repeated).tolist():
            text = f"time {series.time[k]:.9g} s repeats that of {series.row_word} {series.rows[leader[k]]}"
            findings.faults.append(series.fault("repeated_stamp", k, text))
    elif repeated.any():
        done = "dropped" if policy.repeated_stamp == "drop" else "merged into one row without outputs"
        text = f"{counted(int(repeated.sum()), 'repeated time stamp')} {done} ({series.at(repeated)})"
        findings.notes.append(f"{series.name}: {text}")
    if policy.backward_stamp == "error":
        for k in np.flatnonzero(backward).tolist():
            other = f"{before[k]:.9g} s of {series.row_word} {series.rows[leader[k]]}"
            text = f"time {series.time[k]:.9g} s is before the {other}"
            findings.faults.append(series.fault("backward_stamp", k, text))
    elif backward.any():
        text = f"{counted(int(backward.sum()), 'backward time stamp')} dropped ({series.at(backward)})"
        findings.notes.append(f"{series.name}: {text}")
    if policy.repeated_stamp == "mark_missing":
        y = series.y.copy()
        y[leader[repeated]] = np.nan
        series = replace(series, y=y)
    return series.keep(rising)


def nominal_interval(series: Series, interval: float | None, policy: ProblemPolicy) -> float:
    """The interval, s, that the others are held against."""
    return float(interval or policy.nominal_interval or np.median(np.diff(series.time)))


def bridge_gaps(series: Series, nominal: float, policy: ProblemPolicy, findings: Findings) -> list[Series]:
    """Report, fill or split at intervals above ``gap_factor`` times the nominal one."""
    dt = np.diff(series.time)
    gap = dt > policy.gap_factor * nominal
    if not gap.any():
        return [series]
    ends = (np.flatnonzero(gap) + 1).tolist()
    at = series.at(np.concatenate(([False], gap)))
    count = counted(len(ends), "gap")
    if policy.gap == "split":
        return _split(series, ends, f"{count} split the recording (before {at})", findings)
    missing = np.where(gap, np.maximum(np.round(dt / nominal), 2.0) - 1.0, 0.0)
    too_many = missing.sum() > _MAX_FILL * len(series.time)
    if policy.gap == "error" or too_many:
        for k in ends:
            text = (
                f"{dt[k - 1]:.6g} s after {series.row_word} {series.rows[k - 1]}, "
                f"{dt[k - 1] / nominal:.3g} times the nominal {nominal:.6g} s"
            )
            if policy.gap == "mark_missing":
                text += f"; filling would need {missing[k - 1]:.3g} rows, so only split can be chosen"
            findings.faults.append(series.fault("gap", k, text))
        # The parts go on, so that what is wrong inside them is found as well.
        return _parts(series, ends)
    added = int(missing.sum())
    findings.notes.append(
        f"{series.name}: {count} filled with {counted(added, 'row')} without outputs, input held (before {at})"
    )
    return [_filled(series, dt, missing.astype(np.int64))]


def _parts(series: Series, ends: list[int]) -> list[Series]:
    return [series.keep(slice(a, b)) for a, b in pairwise([0, *ends, len(series.time)])]


def _split(series: Series, ends: list[int], note: str, findings: Findings) -> list[Series]:
    """A test for each part between gaps; a part of one sample tells nothing and is left out."""
    parts = _parts(series, ends)
    single = [part for part in parts if len(part.time) < 2]
    if single:
        note += f"; {counted(len(single), 'part')} of a single sample left out"
    findings.notes.append(f"{series.name}: {note}")
    whole = [part for part in parts if len(part.time) >= 2]
    return [replace(part, name=series.name if k == 0 else f"{series.name}-{k + 1}") for k, part in enumerate(whole)]


def _filled(series: Series, dt: Array, missing: Indices) -> Series:
    """Insert ``missing[k]`` rows after sample k, evenly spaced, with its input and without outputs."""
    repeats = np.concatenate((missing, [0])) + 1
    origin: Indices = np.repeat(np.arange(len(series.time), dtype=np.int64), repeats)
    step = np.arange(len(origin)) - np.repeat(np.cumsum(repeats) - repeats, repeats)
    spacing = np.concatenate((dt, [0.0])) / repeats
    filled = series.keep(origin)
    y = filled.y.copy()
    y[step > 0] = np.nan
    return replace(filled, time=filled.time + step * spacing[origin], y=y)


def even_intervals(series: Series, nominal: float, policy: ProblemPolicy, findings: Findings) -> tuple[Series, Array]:
    """Report, keep or resample unequal intervals; the series and its (N-1,) intervals, s."""
    dt = np.diff(series.time)
    unequal = np.abs(dt - nominal) > policy.interval_tolerance * nominal
    if not unequal.any():
        return series, dt
    after = np.concatenate(([False], unequal))
    extremes = f"{dt.min():.6g} to {dt.max():.6g} s where {nominal:.6g} s is nominal"
    count = counted(int(unequal.sum()), "unequal interval")
    if policy.unequal_interval == "error":
        for k in np.flatnonzero(after).tolist():
            text = f"{dt[k - 1]:.6g} s after {series.row_word} {series.rows[k - 1]}, nominal is {nominal:.6g} s"
            findings.faults.append(series.fault("unequal_interval", k, text))
        return series, dt
    if policy.unequal_interval == "keep":
        findings.notes.append(f"{series.name}: {count} kept, {extremes} (before {series.at(after)})")
        return series, dt
    findings.notes.append(
        f"{series.name}: {count}, {extremes}; resampled to {nominal:.6g} s, outputs by linear interpolation, which "
        f"colours the measurement noise and makes it smaller, inputs held (before {series.at(after)})"
    )
    return _resampled(series, nominal)


def _resampled(series: Series, nominal: float) -> tuple[Series, Array]:
    """The series on an even grid from its first time on."""
    # A grid point counts as a sample's own within this share of an interval: rounding must not shift an input.
    snap = 1e-6
    count = int(np.floor((series.time[-1] - series.time[0]) / nominal + snap)) + 1
    grid = series.time[0] + nominal * np.arange(count)
    k = np.searchsorted(series.time, grid + snap * nominal, side="right") - 1
    following = np.minimum(k + 1, len(series.time) - 1)
    width = np.where(following > k, series.time[following] - series.time[k], 1.0)
    weight = (grid - series.time[k]) / width
    weight = np.where(grid - series.time[k] <= snap * nominal, 0.0, weight)[:, None]
    # A missing neighbour makes the value missing, unless the grid point is the other neighbour's own.
    between = (1.0 - weight) * series.y[k] + weight * series.y[following]
    y = np.where(weight == 0.0, series.y[k], between)
    even = replace(series, time=grid, u=series.u[k], y=y, rows=series.rows[k])
    return even, np.full(count - 1, nominal)

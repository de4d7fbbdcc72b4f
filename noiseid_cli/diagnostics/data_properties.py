"""What the numbers of a recording give away before any model is fitted: quantisation, repeated and derived channels.

Quantisation is not noise: a reading that moves in steps carries a rounding error of standard deviation step / sqrt(12)
where the signal crosses many steps, and one that never repeats itself in time where it does not (Widrow & Kollar 2008).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from noiseid_cli.models.recording import Array, Dataset, Recording

# A difference of neighbouring values may miss a whole number of steps by this share of a step: decimals of a log file.
GRID = 0.1
# Values closer than this share of the greatest are the same number written twice.
SAME = 1e-9
# From this share of unchanged neighbours on, a quantised output is called almost at rest [chosen].
RESTING = 0.8
# A derived speed agrees with the difference to this share of its greatest value: nine digits of a log file.
DERIVED, AGREEING = 1e-4, 0.95


def quantisation_step(values: Array) -> float | None:
    """The step of which the differences of all values are whole multiples.

    Args:
        values: (N,) one channel, all tests together; NaN is left out.

    Returns:
        The step, in the channel's unit; None where there is none, or too few values to tell (a step is believed if
        there are ten levels, or each level is met five times on average).
    """
    seen = values[np.isfinite(values)]
    levels = np.unique(seen)
    if len(levels) < 2:
        return None
    gaps = np.diff(levels)
    gaps = gaps[gaps > SAME * np.abs(levels).max()]
    if not len(gaps) or (len(gaps) < 10 and 5 * len(gaps) > len(seen)):
        return None
    step = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    # Small gaps first: each refines the step before a large one is counted in it.
    gaps = np.sort(gaps)
    for upto in (4.5, 40.5, math.inf):
        near = gaps[gaps < upto * step]
        step = float(near.sum() / np.round(near / step).sum())
    counts = np.round(gaps / step)
    return step if bool(np.all(np.abs(gaps - counts * step) <= GRID * step)) else None


def output_steps(dataset: Dataset) -> tuple[float | None, ...]:
    """The quantisation step of each output, in its unit; None where none is found."""
    stacked = np.concatenate([r.y for r in dataset.recordings])
    return tuple(quantisation_step(stacked[:, i]) for i in range(stacked.shape[1]))


def data_warnings(dataset: Dataset) -> list[str]:
    """Say what the data itself gives away.

    Args:
        dataset: the data; its outputs are named.

    Returns:
        Sentences: quantised outputs, outputs almost at rest, identical outputs, outputs that are differences of others.
    """
    names, recordings = [name for name, _, _ in dataset.outputs], dataset.recordings
    out = []
    for i, step in enumerate(output_steps(dataset)):
        if step is None:
            continue
        unit = dataset.outputs[i][1]
        out.append(
            f"{names[i]} moves in steps of {step:.4g} {unit}: rounding alone has a standard deviation of "
            f"{step / math.sqrt(12.0):.3g} {unit}"
        )
        share = _unchanged(recordings, i)
        if share >= RESTING:
            out.append(
                f"{names[i]} keeps its value over {100 * share:.0f} % of the samples: almost at rest, quantisation is "
                "not noise, and Q and R both come out wrong; take a recording that moves"
            )
    pairs = [(i, j) for i in range(len(names)) for j in range(len(names)) if i != j]
    out += [
        f"{names[i]} and {names[j]} are the same numbers: one measurement counted twice; leave one out"
        for i, j in pairs
        if i < j and _identical(recordings, i, j)
    ]
    out += [
        f"{names[j]} is the backward difference of {names[i]}, not a second sensor: the same information counted "
        "twice, and its noise is not white; leave it out"
        for i, j in pairs
        if _is_difference(recordings, i, j)
    ]
    return out


def rounding_warnings(dataset: Dataset, R: Array) -> list[str]:
    """Say which variances of the measurement noise are below those of rounding.

    Args:
        dataset: the data that it was estimated from.
        R: (ny, ny) covariance of the measurement noise, estimated or given.
    """
    out = []
    for (name, unit, _), step, variance in zip(dataset.outputs, output_steps(dataset), np.diag(R), strict=True):
        if step is not None and variance < step**2 / 12.0:
            std = math.sqrt(variance)
            out.append(
                f"the measurement noise of {name}, {std:.3g} {unit} or {std / step:.2g} "
                f"quantisation steps, is below the rounding error of such a sensor, 0.29 steps of {step:.4g} {unit}: "
                "the filter will trust it too much"
            )
    return out


def size_warnings(dataset: Dataset, noises: Sequence[tuple[str, str, str]], Q: Array) -> list[str]:
    """Say which process noises are greater than what drives the system.

    A noise in the unit of an input is compared with the input of that unit that has the greatest root mean square.

    Args:
        dataset: the data that it was estimated from.
        noises: name, unit and description of each process noise, per sample.
        Q: (nv, nv) its covariance per sample, estimated or given.
    """
    u = np.concatenate([r.u for r in dataset.recordings])
    sizes = np.sqrt(np.mean(u**2, axis=0))
    out = []
    for (name, unit, _), variance in zip(noises, np.diag(Q), strict=True):
        rivals = [(float(size), of) for (of, own, _), size in zip(dataset.inputs, sizes, strict=True) if own == unit]
        size, of = max(rivals, default=(0.0, ""))
        std = math.sqrt(variance)
        if unit and 0.0 < size < std:
            out.append(
                f"the process noise {name}, {std:.3g} {unit} per sample, is {std / size:.2g} times the root mean "
                f"square of the input {of}, {size:.3g} {unit}: it stands in for what the model leaves out, not for "
                "noise of the input alone"
            )
    return out


def _unchanged(recordings: Sequence[Recording], i: int) -> float:
    """Share of neighbouring samples between which output i does not change."""
    steps = np.concatenate([np.diff(r.y[:, i]) for r in recordings])
    steps = steps[np.isfinite(steps)]
    return float(np.mean(steps == 0.0)) if len(steps) else 0.0


def _identical(recordings: Sequence[Recording], i: int, j: int) -> bool:
    """Two outputs hold the same numbers, which are not all one."""
    a, b = (np.concatenate([r.y[:, c] for r in recordings]) for c in (i, j))
    seen = a[np.isfinite(a)]
    return len(seen) > 1 and bool(np.ptp(seen) > 0.0) and np.array_equal(a, b, equal_nan=True)


def _is_difference(recordings: Sequence[Recording], i: int, j: int) -> bool:
    """Output j is (y_i[k] - y_i[k-1]) / dt[k-1] to the rounding of a log file, at nearly all samples."""
    parts = list(_differences(recordings, i, j))
    derived, given = (np.concatenate([part[c] for part in parts]) for c in (0, 1))
    if len(given) < 10 or not np.any(given):
        return False
    return bool(np.mean(np.abs(derived - given) <= DERIVED * np.abs(given).max()) >= AGREEING)


def _differences(recordings: Sequence[Recording], i: int, j: int) -> Iterator[tuple[Array, Array]]:
    """Per test the difference quotients of output i and output j, where both are there."""
    for r in recordings:
        derived, given = np.diff(r.y[:, i]) / r.dt, r.y[1:, j]
        both = np.isfinite(derived) & np.isfinite(given)
        yield derived[both], given[both]

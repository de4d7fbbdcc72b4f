"""A slow channel from a file of its own, put on the clock of the fast one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from noiseid_cli.recordings.cells import Series
from noiseid_cli.recordings.faults import Findings, counted


def merge(main: Series, others: Sequence[Series], outputs: Sequence[str], findings: Findings) -> Series:
    """One series with all outputs, on the main one's clock.

    Each value of the others goes to the sample that is nearest in time; a sample takes the nearest value only. Values
    more than half an interval away from every sample are left out. What no value falls on is missing.

    Args:
        main: the series whose clock and inputs are kept; its times rise.
        others: series with rising times and further outputs.
        outputs: names of all outputs, in the model's order.
        findings: a note says how far values were moved and how many were left out.
    """
    columns = dict(zip(main.source.outputs, main.y.T, strict=True))
    for other in others:
        if not len(main.time) or not len(other.time):
            values = np.full((len(main.time), other.y.shape[1]), np.nan)
        else:
            values = _on_clock(main, other, findings)
        columns |= dict(zip(other.source.outputs, values.T, strict=True))
    y = np.column_stack([np.empty((len(main.time), 0))] + [columns[name] for name in outputs])
    maps = {name: m for s in (main, *others) for name, m in s.source.outputs.items()}
    source = replace(main.source, outputs={name: maps[name] for name in outputs}, also=())
    return replace(main, source=source, y=y)


def _on_clock(main: Series, other: Series, findings: Findings) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """(N, m) values of the other series at the main one's samples, NaN elsewhere."""
    after = np.searchsorted(main.time, other.time)
    left, right = np.maximum(after - 1, 0), np.minimum(after, len(main.time) - 1)
    nearest = np.where(other.time - main.time[left] <= main.time[right] - other.time, left, right)
    shift = np.abs(other.time - main.time[nearest])
    width = np.diff(main.time)
    # Half the wider of the intervals on either side; a single sample takes what is exactly on it.
    reach = 0.5 * np.maximum(np.append(width, 0.0), np.append(0.0, width))[nearest] if len(width) else 0.0 * shift
    inside = shift <= reach * (1.0 + 1e-9)
    values = np.full((len(main.time), other.y.shape[1]), np.nan)
    best = np.full(len(main.time), np.inf)
    taken = 0
    for k in np.flatnonzero(inside).tolist():
        if shift[k] < best[nearest[k]]:
            taken += not np.isfinite(best[nearest[k]])
            best[nearest[k]] = shift[k]
            values[nearest[k]] = other.y[k]
    names = ", ".join(other.source.outputs)
    lost = len(other.time) - taken
    text = f"{counted(taken, 'row')} of {other.source.file.name} ({names}) put on the nearest sample"
    if taken:
        text += f", at most {float(best[np.isfinite(best)].max()):.3g} s away"
    if lost:
        text += f"; {counted(lost, 'row')} left out: no sample is near, or another row is nearer"
    findings.notes.append(f"{main.name}: {text}")
    return values

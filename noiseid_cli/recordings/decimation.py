"""Fewer samples of the same recording: a longer sample time, made by decimation."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

from noiseid_cli.errors import DataError
from noiseid_cli.models.recording import Array, Recording
from noiseid_cli.recordings.faults import Findings, counted
from noiseid_cli.recordings.options import Decimation


def decimate(recording: Recording, decimation: Decimation, findings: Findings) -> Recording:
    """A test with one sample for each ``factor`` of them.

    Inputs are held from sample to sample, so their average over a longer interval does to a linear model what they did
    (up to their change within it). Outputs are picked, which leaves their noise as it is, or averaged over each block,
    the time of which is then its mean; missing values are left out of an average.

    Args:
        recording: the test.
        decimation: factor, and what to do with outputs.
        findings: gets a note of what was done.

    Raises:
        DataError: numbers are so large that their sum is none.
    """
    f = decimation.factor
    t, N = recording.time, recording.samples
    if decimation.outputs == "pick":
        first = np.arange(0, N, f)
        at, y = t[first], recording.y[first]
    else:
        blocks = N // f
        first = np.arange(blocks) * f
        at = t[: blocks * f].reshape(blocks, f).mean(axis=1)
        with warnings.catch_warnings():
            # A block without any value is missing: nanmean says so, and warns too.
            warnings.simplefilter("ignore", RuntimeWarning)
            y = np.nanmean(recording.y[: blocks * f].reshape(blocks, f, -1), axis=1)
    done = "picked" if decimation.outputs == "pick" else f"averaged over {f} samples"
    findings.notes.append(
        f"{recording.name}: {counted(len(at), 'sample')} kept of {N}, one in {f}; outputs {done}, inputs averaged over "
        "the longer intervals"
    )
    with np.errstate(over="ignore", invalid="ignore"):
        u = _average(recording, at)
    if not np.isfinite(u).all() or np.isinf(y).any():
        raise DataError(
            f"{recording.name}: numbers are too large to be averaged (decimate); check their unit and scale"
        )
    return replace(recording, dt=np.diff(at), u=u, y=np.ascontiguousarray(y), start=float(at[0]) if len(at) else 0.0)


def _average(recording: Recording, at: Array) -> Array:
    """(len(at), nu) mean of the held inputs between the new times; at the last one the input in force."""
    t = recording.time
    integral = np.vstack((np.zeros(recording.u.shape[1]), np.cumsum(recording.u[:-1] * recording.dt[:, None], axis=0)))
    area = np.column_stack([np.empty((len(at), 0))] + [np.interp(at, t, column) for column in integral.T])
    u = np.empty_like(area)
    u[:-1] = np.diff(area, axis=0) / np.diff(at)[:, None]
    if len(at):
        u[-1] = recording.u[np.searchsorted(t, at[-1], side="right") - 1]
    return u

"""The extended smoother in bounded memory: a long test is smoothed in segments, from the last to the first.

A first run of the filter keeps the prediction at the start of each segment only; on the way back each one is filtered
anew and smoothed from the state that the later one has left at its end. That costs one more run of the filter.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from noiseid_cli.filters.ekf import FilterDivergedError, Filtered, extended_kalman_filter
from noiseid_cli.filters.smoother import Smoothed, extended_kalman_smoother
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording

ROOM = 2**28
"""Bytes that filter and smoother may take for one test, before it is smoothed in segments [chosen]."""


class Part(NamedTuple):
    """A segment with its results; its last sample, which the next segment shares, has no output."""

    recording: Recording
    filtered: Filtered
    smoothed: Smoothed


def segment_length(model: CompiledModel, room: int = ROOM) -> int:
    """Samples whose filtered and smoothed results take ``room`` bytes; at least one."""
    n, nv, ny = model.nx, model.nv, model.ny
    numbers = 3 * n + 5 * n * n + 2 * n * nv + ny * (n + 1) + nv * (n + nv)
    return max(1, room // (8 * numbers))


def smoothed_parts(
    model: CompiledModel, recording: Recording, noise: NoiseValues, test: int, room: int = ROOM
) -> Iterator[Part]:
    """Filter and smooth one test; the parts come from the last to the first, most tests being one part.

    Log-likelihoods, steps and measured samples of the parts add up to those of the test.

    Raises:
        FilterDivergedError: with the sample where it happened.
    """
    N, length = recording.samples, segment_length(model, room)
    if length >= N:
        filtered = extended_kalman_filter(model, recording, noise, test)
        yield Part(recording, filtered, extended_kalman_smoother(filtered, noise.Q))
        return
    cuts = range(0, N - 1, length)
    starts: list[tuple[Array, Array] | None] = [None]
    for cut in cuts:
        part = _part(recording, cut, length)
        try:
            filtered = extended_kalman_filter(model, part, noise, test, starts[-1])
        except FilterDivergedError as error:
            raise FilterDivergedError(error.code, cut + error.step, recording) from None
        starts.append((filtered.m_pred[-1].copy(), filtered.U_pred[-1].copy()))
    end: tuple[Array, Array] | None = None
    for cut, start in zip(reversed(cuts), reversed(starts[:-1]), strict=True):
        if end is not None:
            part = _part(recording, cut, length)
            filtered = extended_kalman_filter(model, part, noise, test, start)
        smoothed = extended_kalman_smoother(filtered, noise.Q, end)
        end = smoothed.m[0].copy(), smoothed.U[0].copy()
        yield Part(part, filtered, smoothed)


def _part(recording: Recording, cut: int, length: int) -> Recording:
    """Samples from ``cut`` on, with the first one of the next part, whose output is counted there."""
    end = min(cut + length, recording.samples - 1)
    y = recording.y[cut : end + 1]
    if end < recording.samples - 1:
        y = y.copy()
        y[-1] = np.nan
    return replace(recording, dt=recording.dt[cut:end], u=recording.u[cut : end + 1], y=y, x_true=None, z_true=None)

"""Smoothing in bounded memory: a long test is taken in segments, from the last to the first.

A first run of the filter keeps the prediction at the start of each segment only; on the way back each one is filtered
anew and smoothed from the state that the later one has left at its end. That costs one more run of the filter.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from noiseid_cli.filters.ekf import FilterDivergedError
from noiseid_cli.filters.smoother import Forward, filter_to_smooth
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording

ROOM = 2**28
"""Bytes that the filter's results may take for one test, before it is taken in segments [chosen]."""


class Part(NamedTuple):
    """A segment with the filter's run; its last sample, which the next segment shares, has no output."""

    recording: Recording
    forward: Forward


def segment_length(model: CompiledModel, room: int = ROOM) -> int:
    """Samples for which the filter's results take ``room`` bytes; at least one."""
    n, nv, ny = model.nx, model.nv, model.ny
    numbers = 2 * n + (n + nv) * (n + nv) + ny * (n + 1) + 1
    return max(1, room // (8 * numbers))


def forward_parts(
    model: CompiledModel, recording: Recording, noise: NoiseValues, test: int, room: int = ROOM
) -> Iterator[Part]:
    """Filter one test; the parts come from the last to the first, most tests being one part.

    Log-likelihoods, steps and measured samples of the parts add up to those of the test. No part is held here:
    who drops each before the next has one in memory at a time.

    Raises:
        FilterDivergedError: with the sample where it happened.
    """
    N, length = recording.samples, segment_length(model, room)
    if length >= N:
        yield Part(recording, filter_to_smooth(model, recording, noise, test))
        return
    cuts = range(0, N - 1, length)
    starts: list[tuple[Array, Array] | None] = [None]
    forward: Forward | None = None
    for cut in cuts:
        part, forward = _part(recording, cut, length), None  # never two at once
        try:
            forward = filter_to_smooth(model, part, noise, test, starts[-1])
        except FilterDivergedError as error:
            raise FilterDivergedError(error.code, cut + error.step, recording) from None
        starts.append((forward.m_pred[-1].copy(), forward.U_pred))
    assert forward is not None
    last, forward = Part(part, forward), None
    yield last
    del last
    for cut, start in zip(reversed(cuts[:-1]), reversed(starts[:-2]), strict=True):
        part = _part(recording, cut, length)
        yield Part(part, filter_to_smooth(model, part, noise, test, start))


def _part(recording: Recording, cut: int, length: int) -> Recording:
    """Samples from ``cut`` on, with the first one of the next part, whose output is counted there."""
    end = min(cut + length, recording.samples - 1)
    y = recording.y[cut : end + 1]
    if end < recording.samples - 1:
        y = y.copy()
        y[-1] = np.nan
    return replace(recording, dt=recording.dt[cut:end], u=recording.u[cut : end + 1], y=y, x_true=None, z_true=None)

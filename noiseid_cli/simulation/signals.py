"""Open-loop inputs for any model."""

from __future__ import annotations

import numpy as np

from noiseid_cli.models.recording import Array


class Signal:
    """Plays given inputs and reads nothing; see ``simulation.rollout.Controller``."""

    reads: tuple[int, ...] = ()

    def __init__(self, u: Array) -> None:
        """Play the rows of u, (N, nu)."""
        self._u = u

    def start(self) -> None:
        """Nothing to forget."""

    def control(self, k: int, y: Array) -> Array:
        """Row k of the inputs."""
        row: Array = self._u[k]
        return row


def multisine(time: Array, amplitude: Array, lowest: float, highest: float, lines: int) -> Array:
    """Sums of equally strong cosines at evenly spaced frequencies, one column per input.

    Schroeder's phases -pi k (k - 1) / lines keep the peaks low (IEEE Trans. Information Theory 16, 1970). The inputs
    use the frequencies in turn, input j those of number j, j + nu, ...: so no two of them are alike, unless lowest
    equals highest. Nothing is random: every test has the same inputs.

    Args:
        time: (N,) s.
        amplitude: (nu,) largest magnitude of each input, in the input's unit.
        lowest, highest: range of the frequencies, Hz.
        lines: number of frequencies of each input.

    Returns:
        (N, nu) inputs.
    """
    inputs = len(amplitude)
    frequencies = np.linspace(lowest, highest, lines * inputs)
    k = np.arange(1, lines + 1)
    phases = -np.pi * k * (k - 1) / lines
    u = np.empty((len(time), inputs))
    for j in range(inputs):
        wave = np.cos(2 * np.pi * np.outer(time, frequencies[j::inputs]) + phases).sum(axis=1)
        u[:, j] = amplitude[j] * wave / np.abs(wave).max()
    return u


def steps(time: Array, amplitude: Array, hold: float) -> Array:
    """Inputs that jump between plus and minus their amplitude, one column per input.

    Input j changes its sign every 2^j hold times, so that all combinations of signs occur in turn.

    Args:
        time: (N,) s.
        amplitude: (nu,) magnitude of each input, in the input's unit.
        hold: shortest time between jumps, s.

    Returns:
        (N, nu) inputs.
    """
    # A sample that should fall on a jump may lie a rounding error before it.
    count = np.floor(time / hold + 1e-9).astype(np.int64)
    turns = count[:, None] >> np.arange(len(amplitude))
    u: Array = np.where(turns % 2 == 0, 1.0, -1.0) * amplitude
    return u

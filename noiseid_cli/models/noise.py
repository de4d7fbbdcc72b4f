"""The noise values of a model: everything about it that is random."""

from __future__ import annotations

from dataclasses import dataclass

from noiseid_cli.models.recording import Array


@dataclass(frozen=True)
class NoiseValues:
    """Everything that is random about a model.

    Attributes:
        Q: (nv, nv) covariance of the process noise.
        R: (ny, ny) covariance of the measurement noise.
        m0: (tests, nx) mean of the first state of each test.
        P0: (nx, nx) covariance of the first state, the same for all tests.
    """

    Q: Array
    R: Array
    m0: Array
    P0: Array

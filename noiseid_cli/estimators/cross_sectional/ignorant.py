"""The filter ignorant of b, and what it tells about b (porter1983_partitioned_recursive, steps 1 to 3).

Where b is left out, innovations are nu_I(k) = T_k b + white: T_k = C U_k, U_0 = T, U_{k+1} = A (I - K C) U_k.
All that the data of a test say about beta is in J = sum T' B_I^-1 T, j = sum T' B_I^-1 nu_I and c.
"""

# ruff: noqa: N815 - derivatives carry the paper's letters
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.cross_sectional.differentiated import differentiated_filter
from noiseid_cli.models.parametric import ParametricMatrices
from noiseid_cli.models.recording import Array, Recording


@dataclass(frozen=True)
class Statistics:
    """What a test says, whatever mu and Sigma; leading axes may stack tests.

    Attributes:
        gram: (..., 1 + nb, 1 + nb) sum over samples of [nu_I T]' B_I^-1 [nu_I T], so J = gram[1:, 1:], j = gram[1:, 0].
        dgram: (..., na, 1 + nb, 1 + nb) its derivatives in alpha.
        logdet: (...) sum of log det B_I; dlogdet: (..., na).
        cross: (..., na, 1 + nb, nb) sum of [g^u g]' B_I^-1 T; g, g^u are innovations of the derivative in alpha of the
            responses to each b and to the recorded input.
    """

    gram: Array
    dgram: Array
    logdet: Array
    dlogdet: Array
    cross: Array

    @classmethod
    def stack(cls, tests: list[Statistics]) -> Statistics:
        """Several tests as one, with a leading axis."""
        return cls(
            np.array([s.gram for s in tests]),
            np.array([s.dgram for s in tests]),
            np.array([s.logdet for s in tests]),
            np.array([s.dlogdet for s in tests]),
            np.array([s.cross for s in tests]),
        )


@dataclass(frozen=True)
class Whitened:
    """Innovations of one test, whitened sample by sample: G (N, ny, nc), dG (p, N, ny, nc), dS (p, N, ny, ny).

    g (na, N, ny, nz) are those of the derivative columns; logdet is the sum of log det of the innovation covariances.
    """

    G: Array
    dG: Array
    dS: Array
    g: Array
    logdet: float


def run_filter(
    m: ParametricMatrices, recording: Recording, P: Array, dP: Array, X: Array, dX: Array, Z: Array, Y: Array
) -> Whitened:
    """Call the compiled filter on one test; P, dP, X, dX, Z, Y are its start, see ``differentiated_filter``.

    Raises:
        EstimationError: an innovation covariance is not positive definite.
    """
    N, ny = recording.y.shape
    p, na, nc, nz = len(dP), len(m.dA), X.shape[1], Z.shape[1]
    G, dG, dS = np.empty((N, ny, nc)), np.empty((p, N, ny, nc)), np.empty((p, N, ny, ny))
    g = np.empty((na, N, ny, nz))
    step, logdet = differentiated_filter(
        m.A, m.B, m.Q, m.C, m.D, m.R, m.dA, m.dB, m.dQ, m.dC, m.dD, m.dR,
        np.ascontiguousarray(recording.u), np.ascontiguousarray(recording.y), P, dP, X, dX, Z, Y, G, dG, dS, g,
    )  # fmt: skip
    if step >= 0:
        raise EstimationError(
            f"test {recording.name!r}: the innovation covariance at sample {step + 1} of {N} is not positive definite"
        )
    return Whitened(G, dG, dS, g, logdet)


def ignorant_filter(m: ParametricMatrices, recording: Recording, T: Array) -> Whitened:
    """Filter one test as if b were zero; columns [nu_I T], with the derivative columns of the cross blocks."""
    nx, nb = T.shape
    na = len(m.dA)
    columns = np.ascontiguousarray(np.hstack((np.zeros((nx, 1)), T)))
    zeros = np.zeros((na, nx, 1 + nb))
    return run_filter(m, recording, m.S_a.copy(), m.dS_a.copy(), -columns, zeros, columns, zeros.copy())


def statistics(run: Whitened) -> Statistics:
    """Sum the whitened innovations of the ignorant filter."""
    na, N, ny, nc = run.dG.shape
    G = run.G.reshape(N * ny, nc)
    gram = G.T @ G
    dG = run.dG.reshape(na, N * ny, nc)
    SG = (run.dS @ run.G).reshape(na, N * ny, nc)
    half = dG.transpose(0, 2, 1) @ G
    dgram = half + half.transpose(0, 2, 1) - SG.transpose(0, 2, 1) @ G
    cross = run.g.reshape(na, N * ny, nc).transpose(0, 2, 1) @ G[:, 1:]
    return Statistics(gram, dgram, np.array(run.logdet), np.einsum("aknn->a", run.dS), cross)

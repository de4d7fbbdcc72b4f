"""The filter ignorant of b, and what it tells about b (porter1983_partitioned_recursive, steps 1 to 3).

Where b is left out, innovations are nu_I(k) = T_k b + white: T_k = C U_k, U_0 = T, U_{k+1} = A (I - K C) U_k.
All that the data of a test say about beta is in J = sum T' B_I^-1 T, j = sum T' B_I^-1 nu_I and c.
"""

# ruff: noqa: N815 - derivatives carry the paper's letters
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.cross_sectional.differentiated import differentiated_filter
from noiseid_cli.models.parametric import ParametricMatrices
from noiseid_cli.models.recording import Array, Recording


@dataclass(frozen=True)
class Statistics:
    """What tests say, whatever mu and Sigma; the leading axis is that of the tests.

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
    def empty(cls, tests: int, na: int, nb: int) -> Statistics:
        """Room for tests."""
        n = 1 + nb
        return cls(
            np.empty((tests, n, n)), np.empty((tests, na, n, n)), np.empty(tests), np.empty((tests, na)),
            np.empty((tests, na, n, nb)),
        )  # fmt: skip

    def put(self, which: list[int], some: Statistics) -> None:
        """Fill in the tests numbered ``which``."""
        for field in fields(self):
            getattr(self, field.name)[which] = getattr(some, field.name)


@dataclass(frozen=True)
class Whitened:
    """Innovations of tests that share a filter, whitened sample by sample, with p derivatives.

    Attributes:
        tests: number of them: the first columns of G and dG are theirs, the first of g theirs too.
        G, dG: (N, ny, nc), (p, N, ny, nc); dS: (p, N, ny, ny), common to all.
        g: (na, N, ny, nz) innovations of the derivative columns.
        logdet: sum of log det of the innovation covariances of one test.
    """

    tests: int
    G: Array
    dG: Array
    dS: Array
    g: Array
    logdet: float


def run_filter(
    m: ParametricMatrices, tests: Sequence[Recording], P: Array, dP: Array, X: Array, dX: Array, Z: Array, Y: Array
) -> Whitened:
    """Call the compiled filter on tests with equal matrices, length and missing outputs.

    P, dP, X, dX, Z, Y are its start, see ``differentiated_filter``.

    Raises:
        EstimationError: an innovation covariance is not positive definite.
    """
    N, ny = tests[0].y.shape
    p, na, nc, nz = len(dP), len(m.dA), X.shape[1], Z.shape[1]
    u, y = np.stack([r.u for r in tests], axis=2), np.stack([r.y for r in tests], axis=2)
    G, dG, dS = np.empty((N, ny, nc)), np.empty((p, N, ny, nc)), np.empty((p, N, ny, ny))
    g = np.empty((na, N, ny, nz))
    step, logdet = differentiated_filter(
        m.A, m.B, m.Q, m.C, m.D, m.R, m.dA, m.dB, m.dQ, m.dC, m.dD, m.dR, u, y, P, dP, X, dX, Z, Y, G, dG, dS, g
    )
    if step >= 0:
        raise EstimationError(
            f"test {tests[0].name!r}: the innovation covariance at sample {step + 1} of {N} is not positive definite"
        )
    return Whitened(len(tests), G, dG, dS, g, logdet)


def ignorant_filter(m: ParametricMatrices, tests: Sequence[Recording], T: Array) -> Whitened:
    """Filter tests as if b were zero; columns [nu_I of each, T], with the derivative columns of the cross blocks."""
    columns = np.ascontiguousarray(np.hstack((np.zeros((len(T), len(tests))), T)))
    zeros = np.zeros((len(m.dA), *columns.shape))
    return run_filter(m, tests, m.S_a.copy(), m.dS_a.copy(), -columns, zeros, columns, zeros.copy())


def statistics(run: Whitened) -> Statistics:
    """Sum the whitened innovations of the ignorant filter; with a leading axis of its tests."""
    na, N, ny, nc = run.dG.shape
    M, flat = run.tests, (na, N * ny, nc)
    G, dG, g = run.G.reshape(N * ny, nc), run.dG.reshape(flat), run.g.reshape(flat)
    SG = (run.dS @ run.G).reshape(flat)
    gram = _bordered(G[:, :M], G[:, :M], G[:, M:], G[:, M:])
    dgram, cross = np.empty((na, *gram.shape)), np.empty((na, *gram.shape[:2], nc - M))
    for i in range(na):
        half = _bordered(dG[i, :, :M], G[:, :M], dG[i, :, M:], G[:, M:])
        dgram[i] = half + half.transpose(0, 2, 1) - _bordered(SG[i, :, :M], G[:, :M], SG[i, :, M:], G[:, M:])
        cross[i, :, 0] = g[i, :, :M].T @ G[:, M:]
        cross[i, :, 1:] = g[i, :, M:].T @ G[:, M:]
    return Statistics(
        gram,
        dgram.swapaxes(0, 1),
        np.full(M, run.logdet),
        np.tile(np.einsum("aknn->a", run.dS), (M, 1)),
        cross.swapaxes(0, 1),
    )


def _bordered(a: Array, b: Array, A: Array, B: Array) -> Array:
    """[a_t A]' [b_t B] of each column t, (columns, 1 + nb, 1 + nb)."""
    nb = A.shape[1]
    out = np.empty((a.shape[1], 1 + nb, 1 + nb))
    out[:, 0, 0] = np.einsum("nt,nt->t", a, b)
    out[:, 0, 1:], out[:, 1:, 0] = a.T @ B, (A.T @ b).T
    out[:, 1:, 1:] = A.T @ B
    return out

"""The E-step of EM: smooth every test and gather what the M-steps need, in square-root form.

The expected second moments of v and e are accumulated as triangular factors (each sample adds rows, one
triangularisation absorbs them), so that every M-step is symmetric and positive semidefinite by construction.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import types

from noiseid_cli.errors import EstimationError
from noiseid_cli.filters.ekf import cube, extended_kalman_filter
from noiseid_cli.filters.linalg import left_solve, triangularise, upper_factor
from noiseid_cli.filters.smoother import extended_kalman_smoother
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.discretisation import transition, work_size
from noiseid_cli.models.jit import kernel, routine
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording
from noiseid_cli.models.signatures import DriftJacobian, OutputJacobian, matrix, vector

SMOOTHED, FILTERED = 0, 1
LINEARISATIONS = {"smoothed": SMOOTHED, "filtered": FILTERED}


@dataclass(frozen=True)
class Statistics:
    """What one pass over the data gives.

    Attributes:
        loglik: log-likelihood of all tests under the values of the pass.
        U_v: (nv, nv) factor of the sum over steps of E[v v' | y]; steps: number of steps.
        U_e: (ny, ny) factor of the sum over samples of E[e e' | y], zero rows where a block was not measured.
        samples: (ny,) number of samples that count for each output.
        m_first: (tests, nx) smoothed mean and U_first: (tests, nx, nx) factor of the first state.
        singular: number of singular predictions, see ``Smoothed``.
    """

    loglik: float
    U_v: Array
    steps: int
    U_e: Array
    samples: Array
    m_first: Array
    U_first: Array
    singular: int

    @property
    def moment_v(self) -> Array:
        """(nv, nv) mean of E[v v' | y]: the M-step of an unstructured Q."""
        return self.U_v.T @ self.U_v / self.steps

    @property
    def moment_e(self) -> Array:
        """(ny, ny) mean of E[e e' | y]; entries of outputs that were never measured are NaN."""
        s = np.sqrt(self.samples)
        with np.errstate(invalid="ignore"):
            moment: Array = self.U_e.T @ self.U_e / np.outer(s, s)
        return moment


def e_step(
    model: CompiledModel,
    recordings: Sequence[Recording],
    noise: NoiseValues,
    linearisation: int = SMOOTHED,
    block_of: np.ndarray[tuple[int], np.dtype[np.int64]] | None = None,
) -> Statistics:
    """One pass: filter, smooth, and accumulate over all tests (axelsson2011_poster, E-step; METHODS 2).

    Args:
        model, recordings, noise: the problem.
        linearisation: SMOOTHED takes F1 and its Jacobian anew at the smoothed states, as the paper does; FILTERED uses
            the filter's own linearisation, under which the statistics are those of the likelihood that it reports.
        block_of: (ny,) block of each output; a block of R is completed or left out as one where outputs are missing.
            Without it the measurement statistics are not gathered.

    Raises:
        FilterDivergedError: the filter failed; with test and sample.
    """
    nx, nv, ny = model.nx, model.nv, model.ny
    U_v, U_e, samples = np.zeros((nv, nv)), np.zeros((ny, ny)), np.zeros(ny)
    m_first, U_first = np.empty((len(recordings), nx)), np.empty((len(recordings), nx, nx))
    loglik, singular, steps = 0.0, 0, 0
    UR = upper_factor(noise.R, "the measurement noise covariance R")
    for i, recording in enumerate(recordings):
        filtered = extended_kalman_filter(model, recording, noise, i)
        smoothed = extended_kalman_smoother(filtered, noise.Q)
        loglik += filtered.loglik
        singular += smoothed.singular
        steps += recording.samples - 1
        m_first[i], U_first[i] = smoothed.m[0], smoothed.U[0]
        dt, u, y = (np.ascontiguousarray(a) for a in (recording.dt, recording.u, recording.y))
        if linearisation == FILTERED:
            _process_filtered(filtered.m_pred, smoothed.m, smoothed.U, smoothed.gain, smoothed.C, U_v)
        else:
            dependent = _process_smoothed(
                model.scheme, model.drift_jacobian, model.parameters, dt, u,
                smoothed.m, smoothed.U, smoothed.gain, smoothed.C, U_v,
            )  # fmt: skip
            if dependent >= 0:
                raise EstimationError(
                    f"test {recording.name!r}, sample {dependent + 1}: the columns of the noise gain F2 are linearly "
                    "dependent, so that the data cannot tell the process noises apart; drop one of them"
                )
        if block_of is not None:
            _measurement(
                model.output_jacobian, model.parameters, u, y, filtered.m_pred, filtered.H, filtered.innovation,
                smoothed.m, smoothed.U, UR, block_of, linearisation, U_e, samples,
            )  # fmt: skip
    return Statistics(loglik, U_v, steps, U_e, samples, m_first, U_first, singular)


@routine
def absorb(total, rows, W, w):  # type: ignore[no-untyped-def]
    """Triangularise [total; W[p:p + rows]] back into the upper factor ``total`` (p, p)."""
    p = total.shape[0]
    for r in range(p):
        for c in range(p):
            W[r, c] = total[r, c]
    triangularise(W, p + rows, p, p, w)
    for r in range(p):
        for c in range(p):
            total[r, c] = W[r, c]


@kernel(types.void(matrix, matrix, cube, cube, cube, matrix))
def _process_filtered(m_pred, m, U, gain, C, U_v):  # type: ignore[no-untyped-def]
    """Add E[v v' | y] under the filter's linearisation: the smoother's own posterior of v_k."""
    N, n = m.shape
    nv = U_v.shape[0]
    rows = C.shape[1]
    W = np.empty((nv + rows + n + 1, nv))
    w = np.empty(nv)
    for k in range(N - 1):
        for c in range(nv):
            for r in range(rows):
                W[nv + r, c] = C[k, r, n + c]
            for r in range(n):
                total = 0.0
                for j in range(r, n):
                    total += U[k + 1, r, j] * gain[k, n + c, j]
                W[nv + rows + r, c] = total
            total = 0.0
            for j in range(n):
                total += gain[k, n + c, j] * (m[k + 1, j] - m_pred[k + 1, j])
            W[nv + rows + n, c] = total
        absorb(U_v, rows + n + 1, W, w)


@kernel(
    types.int64(types.int64, DriftJacobian, vector, vector, matrix, matrix, cube, cube, cube, matrix),
)  # fmt: skip
def _process_smoothed(scheme, drift_jacobian, p, dt, u, m, U, gain, C, U_v):  # type: ignore[no-untyped-def]
    """Add F2^+ M F2^+' of the paper's M-step, J1 and F2 taken at the smoothed states.

    M = (-J1 I) P^xi (-J1 I)' + r r' has the rows -C_x J1', U_{k+1} (I - J1 X)' and r'; F2^+ is applied by a
    triangularisation of [F2, rows'] and back-substitution. Returns the sample where F2 lacks full column rank, or -1.
    """
    N, n = m.shape
    nv = U_v.shape[0]
    if nv > n:
        return 0
    rows = C.shape[1]
    total_rows = rows + n + 1
    x_next = np.empty(n)
    J1 = np.empty((n, n))
    F2 = np.empty((n, nv))
    work = np.empty(work_size(n, nv))
    L = np.empty((n, nv + total_rows))
    w = np.empty(nv + total_rows)
    W = np.empty((nv + total_rows, nv))
    for k in range(N - 1):
        transition(scheme, drift_jacobian, m[k], u[k], dt[k], p, x_next, J1, F2, work)
        for i in range(n):
            for c in range(nv):
                L[i, c] = F2[i, c]
            for r in range(rows):
                total = 0.0
                for j in range(n):
                    total -= C[k, r, j] * J1[i, j]
                L[i, nv + r] = total
            L[i, nv + rows + n] = m[k + 1, i] - x_next[i]
        # I - J1 X, then its rows through U_{k+1}.
        for i in range(n):
            for c in range(n):
                w[c] = 1.0 if i == c else 0.0
                for j in range(n):
                    w[c] -= J1[i, j] * gain[k, j, c]
            for r in range(n):
                total = 0.0
                for j in range(r, n):
                    total += U[k + 1, r, j] * w[j]
                L[i, nv + rows + r] = total
        if not left_solve(L, nv, nv + total_rows, W[nv:], w):
            return k
        absorb(U_v, total_rows, W, w)
    return -1


@routine
def _complete(UR, block, seen, E, rows, W, w):  # type: ignore[no-untyped-def]
    """Fill the missing outputs of one block of E by their expectation given the seen ones, under e ~ N(0, R).

    E has ``rows`` rows; as many rows as there are missing outputs are added, the factor of what stays open.
    Returns the new number of rows. ``block`` lists the outputs of the block, ``seen`` says which were measured.
    """
    ny = UR.shape[0]
    q = 0
    for i in block:
        if seen[i]:
            for r in range(ny):
                W[r, q] = UR[r, i]
            q += 1
    p = q
    for i in block:
        if not seen[i]:
            for r in range(ny):
                W[r, p] = UR[r, i]
            p += 1
    # [R_oo factor, its product with R_om; 0, factor of R_mm given o].
    triangularise(W, ny, p, p, w)
    for r in range(rows):
        for a in range(q):
            w[a] = 0.0
        a = 0
        for i in block:
            if seen[i]:
                w[a] = E[r, i]
                for b in range(a):
                    w[a] -= W[b, a] * w[b]
                w[a] /= W[a, a]
                a += 1
        c = q
        for i in block:
            if not seen[i]:
                E[r, i] = 0.0
                for a in range(q):
                    E[r, i] += w[a] * W[a, c]
                c += 1
    for r in range(q, p):
        for j in range(ny):
            E[rows, j] = 0.0
        c = q
        for i in block:
            if not seen[i]:
                E[rows, i] = W[r, c]
                c += 1
        rows += 1
    return rows


@kernel(
    types.void(
        OutputJacobian, vector, matrix, matrix, matrix, cube, matrix, matrix, cube, matrix,
        types.int64[::1], types.int64, matrix, vector,
    ),
)  # fmt: skip
def _measurement(  # type: ignore[no-untyped-def]
    output_jacobian, p, u, y, m_pred, H_pred, innovation, m, U, UR, block_of, linearisation, U_e, samples
):
    """Add E[e e' | y]: rows U_k H' and the residual, completed where outputs are missing."""
    N, n = m.shape
    ny = y.shape[1]
    y_hat = np.empty(ny)
    H = np.empty((ny, n))
    seen = np.empty(ny, dtype=np.bool_)
    block = np.empty(ny, dtype=np.int64)
    W = np.empty((2 * ny + n + 1, ny))
    E = np.empty((n + 1 + ny, ny))
    w = np.empty(ny)
    for k in range(N):
        if linearisation == FILTERED:
            H[:, :] = H_pred[k]
            for i in range(ny):
                y_hat[i] = y[k, i] - innovation[k, i]
                for j in range(n):
                    y_hat[i] += H[i, j] * (m[k, j] - m_pred[k, j])
        else:
            output_jacobian(m[k], u[k], p, y_hat, H)
        any_seen = False
        for i in range(ny):
            seen[i] = not math.isnan(y[k, i])
            any_seen = any_seen or seen[i]
            for r in range(n):
                total = 0.0
                for j in range(r, n):
                    total += U[k, r, j] * H[i, j]
                E[r, i] = total if seen[i] else 0.0
            E[n, i] = y[k, i] - y_hat[i] if seen[i] else 0.0
        if not any_seen:
            continue
        rows = n + 1
        for b in range(ny):
            size = 0
            count = 0
            for i in range(ny):
                if block_of[i] == b:
                    block[size] = i
                    size += 1
                    count += 1 if seen[i] else 0
            if count == 0:
                continue
            for i in block[:size]:
                samples[i] += 1.0
            if count < size:
                rows = _complete(UR, block[:size], seen, E, rows, W, w)
        for r in range(rows):
            for i in range(ny):
                W[ny + r, i] = E[r, i]
        absorb(U_e, rows, W, w)

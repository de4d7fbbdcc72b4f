"""EM's second moments by the extended smoother: the way back over one test, on which only the sums are kept.

Where steps are equal and the smoothed covariance has come to rest (see ``filters.rest``), only means are computed.
"""

from __future__ import annotations

import numpy as np
from numba import types

from noiseid_cli.estimators.measurement_moment import add_measured
from noiseid_cli.estimators.process_moment import add_mean, left_inverse, spread_filtered, spread_smoothed
from noiseid_cli.filters.ekf import cube
from noiseid_cli.filters.rest import at_rest, same
from noiseid_cli.filters.smoother import carry_factor, carry_mean
from noiseid_cli.models.arrays import copy, copy_matrix
from noiseid_cli.models.discretisation import transition, workspace
from noiseid_cli.models.jit import kernel, routine
from noiseid_cli.models.signatures import DriftJacobian, OutputJacobian, matrix, vector

SMOOTHED, FILTERED = 0, 1
LINEARISATIONS = {"smoothed": SMOOTHED, "filtered": FILTERED}

Index = types.int64[::1]


@routine
def _shifted(y, innovation, H, m, m_pred, y_hat):  # type: ignore[no-untyped-def]
    """Write the outputs at m under the filter's linearisation to y_hat; NaN where an output is missing."""
    for i in range(y_hat.shape[0]):
        y_hat[i] = y[i] - innovation[i]
        for j in range(m.shape[0]):
            y_hat[i] += H[i, j] * (m[j] - m_pred[j])


@kernel(
    types.int64(
        types.int64, DriftJacobian, OutputJacobian, vector, vector, matrix, matrix, matrix,
        matrix, matrix, cube, cube, Index, cube, matrix,
        types.int64, Index, vector, matrix, matrix, matrix, vector,
    ),
)  # fmt: skip
def gather_back(  # type: ignore[no-untyped-def]
    scheme, drift_jacobian, output_jacobian, p, dt, u, y, UR,
    m_pred, m_filt, gain, C, source, H_pred, innovation,
    linearisation, block_of, m_end, U_end, sum_v, sum_e, samples,
):  # fmt: skip
    """Smooth one test and add up its moments.

    Args:
        scheme, drift_jacobian, output_jacobian, p, dt, u, y: the model and the test; UR: (ny, ny) factor of R.
        m_pred, m_filt, gain, C, source, H_pred, innovation: of ``smoother.Forward``.
        linearisation: SMOOTHED or FILTERED; block_of: (ny,), or empty where sum_e is not wanted.
        m_end, U_end: smoothed mean (n,) and factor (n, n) of the last sample; those of the first come out.
        sum_v, sum_e, samples: of ``em_statistics.Statistics``, added to.

    Returns:
        The first sample at whose smoothed state F2 lacks full column rank, or -1.
    """
    N, n = m_filt.shape
    nv, ny = len(sum_v), len(UR)
    rows = C.shape[1]
    if linearisation != FILTERED and nv > n:
        return 0
    # Of the later and of the earlier sample, in turns.
    m, U, at = np.empty((2, n)), np.empty((2, n, n)), 0
    copy_matrix(U_end, U[0])
    J, F2, H = np.empty((2, n, n)), np.empty((2, n, nv)), np.empty((2, ny, n))
    W, w, before = np.empty((rows + n, max(n, nv))), np.empty(n + nv), np.empty((2, n, n))
    work, x_next, r = workspace(n, nv), np.empty(n), np.empty(n)
    A, X, L = np.empty((n, nv + n)), np.empty((n, nv)), np.empty((nv, n))
    B, D, row, spread_v = np.empty((nv, n)), np.empty((nv, n)), np.empty((1, nv)), np.empty((nv, nv))
    y_hat, seen, block = np.empty(ny), np.empty(ny, dtype=np.bool_), np.empty(ny, dtype=np.int64)
    E, W_e, w_e, spread_e = np.empty((n + 1 + ny, ny)), np.empty((ny, ny)), np.empty(ny), np.empty((ny, ny))
    alike, rests, carried, known, equal = 0, False, False, False, False
    regular, dependent = True, -1
    for k in range(N - 1, -1, -1):
        now, later = k % 2, 1 - k % 2
        if k == N - 1:
            copy(m_end, m[now])
        else:
            s = source[k]
            equal = k < N - 2 and s == source[k + 1]
            carry_mean(m_filt[k], m_pred[k + 1], m[later], gain[s], m[now])
            if linearisation == FILTERED:
                if not (equal and carried):
                    spread_filtered(U[at], gain[s], C[s], W, spread_v)
                for i in range(n):
                    r[i] = m[later, i] - m_pred[k + 1, i]
                add_mean(gain[s, n:], r, row, sum_v)
            else:
                transition(scheme, drift_jacobian, m[now], u[k], dt[k], p, x_next, J[now], F2[now], work)
                same_noise = k < N - 2 and same(F2[now], F2[later])
                if not same_noise:
                    regular = left_inverse(F2[now], A, X, w, L)
                if not regular:
                    dependent = k
                elif not (same_noise and equal and carried and same(J[now], J[later])):
                    spread_smoothed(L, J[now], U[at], gain[s], C[s], B, D, W, spread_v)
                for i in range(n):
                    r[i] = m[later, i] - x_next[i]
                add_mean(L, r, row, sum_v)
            sum_v += spread_v
            carried = rests and equal
            if not carried:
                carry_factor(U[at], gain[s], C[s], U[1 - at], W, w)
                at = 1 - at
                alike = alike + 1 if equal else 0
                rests = at_rest(U[at], rows + n, before, alike)
        if len(block_of) > 0:
            if linearisation == FILTERED:
                _shifted(y[k], innovation[k], H_pred[k], m[now], m_pred[k], y_hat)
                copy_matrix(H_pred[k], H[now])
            else:
                output_jacobian(m[now], u[k], p, y_hat, H[now])
            fresh = not (known and carried and same(H[now], H[later]))
            known = add_measured(
                y[k], y_hat, H[now], U[at], fresh, UR, block_of, seen, block, E, W_e, w_e, spread_e, sum_e, samples
            )
    copy(m[0], m_end)
    copy_matrix(U[at], U_end)
    return dependent

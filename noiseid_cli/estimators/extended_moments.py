"""EM's second moments by the extended smoother: the way back over one test, on which only the sums are kept.

Where steps are equal and the smoothed covariance has come to rest (see ``filters.rest``), only means are computed.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import types

from noiseid_cli.estimators import measurement_moment, process_moment
from noiseid_cli.estimators.measurement_moment import add_measured
from noiseid_cli.estimators.process_moment import add_moment, left_inverse, spread_filtered, spread_smoothed
from noiseid_cli.filters import smoother
from noiseid_cli.filters.ekf import cube
from noiseid_cli.filters.rest import at_rest, same
from noiseid_cli.filters.smoother import carry_factor, carry_joint, carry_mean
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
    allocates=True,
)  # fmt: skip
def gather_back(  # type: ignore[no-untyped-def]
    scheme, drift_jacobian, output_jacobian, p, dt, u, y, UR,
    m_pred, m_filt, gain_t, C, source, H_pred, innovation,
    linearisation, block_of, m_end, U_end, sum_v, sum_e, samples,
):  # fmt: skip
    """Smooth one test and add up its moments.

    Args:
        scheme, drift_jacobian, output_jacobian, p, dt, u, y: the model and the test; UR: (ny, ny) factor of R.
        m_pred, m_filt, gain_t, C, source, H_pred, innovation: of ``smoother.Forward``.
        linearisation: SMOOTHED or FILTERED; block_of: (ny,), or empty where sum_e is not wanted.
        m_end, U_end: smoothed mean (n,) and factor (n, n) of the last sample; those of the first come out.
        sum_v, sum_e, samples: of ``em_statistics.Statistics``, added to.

    Returns:
        The first sample at whose smoothed state F2 lacks full column rank, or -1.
    """
    n, nv, ny, rows = m_filt.shape[1], len(sum_v), len(UR), C.shape[1]
    if linearisation != FILTERED and nv > n:
        return 0
    own = Scratch(
        np.empty((2, n)), np.empty((2, n, n)), np.empty((2, n, n)), np.empty((2, n, nv)), np.empty((2, ny, n)),
        np.empty((2, n, n)), workspace(n, nv), np.empty(n), np.empty(n), np.empty(ny),
    )  # fmt: skip
    return _steps(
        scheme, drift_jacobian, output_jacobian, p, dt, u, y, UR,
        m_pred, m_filt, gain_t, C, source, H_pred, innovation,
        linearisation, block_of, m_end, U_end, sum_v, sum_e, samples,
        own, smoother.scratch(n, nv, rows), process_moment.scratch(n, nv, rows), measurement_moment.scratch(n, ny),
    )  # fmt: skip


class Scratch(NamedTuple):
    """What ``_steps`` works in; of pairs, one is the later sample's and one the earlier's, in turns."""

    m: Any  # (2, n)
    U: Any  # (2, n, n)
    J: Any  # (2, n, n)
    F2: Any  # (2, n, nv)
    H: Any  # (2, ny, n)
    before: Any  # (2, n, n), see ``rest``
    work: Any
    x_next: Any  # (n,)
    r: Any  # (n,)
    y_hat: Any  # (ny,)


@routine
def _steps(  # type: ignore[no-untyped-def]
    scheme, drift_jacobian, output_jacobian, p, dt, u, y, UR,
    m_pred, m_filt, gain_t, C, source, H_pred, innovation,
    linearisation, block_of, m_end, U_end, sum_v, sum_e, samples,
    own, back, process, measured,
):  # fmt: skip
    """The loop of ``gather_back``; the last four are scratch."""
    N, n = m_filt.shape
    nv = len(sum_v)
    rows = C.shape[1]
    m, U, J, F2, H, r = own.m, own.U, own.J, own.F2, own.H, own.r
    at = 0
    copy_matrix(U_end, U[0])
    alike, rests, carried, known, equal = 0, False, False, False, False
    regular, dependent = True, -1
    for k in range(N - 1, -1, -1):
        now, later = k % 2, 1 - k % 2
        if k == N - 1:
            copy(m_end, m[now])
        else:
            g = source[k]
            equal = k < N - 2 and g == source[k + 1]
            stays = equal and carried
            carry_mean(m_filt[k], m_pred[k + 1], m[later], gain_t[g], m[now])
            if linearisation == FILTERED:
                if not stays:
                    carry_joint(U[at], gain_t[g], C[g], back)
                    spread_filtered(n, back.W, process)
                    for c in range(nv):
                        for j in range(n):
                            process.L[c, j] = gain_t[g, j, n + c]
                for i in range(n):
                    r[i] = m[later, i] - m_pred[k + 1, i]
            else:
                transition(scheme, drift_jacobian, m[now], u[k], dt[k], p, own.x_next, J[now], F2[now], own.work)
                same_noise = k < N - 2 and same(F2[now], F2[later])
                if not same_noise:
                    regular = left_inverse(F2[now], process)
                stays = stays and same_noise and same(J[now], J[later])
                if not regular:
                    dependent = k
                if not stays:
                    carry_joint(U[at], gain_t[g], C[g], back)
                    spread_smoothed(J[now], U[at], back.W, process)
                for i in range(n):
                    r[i] = m[later, i] - own.x_next[i]
            add_moment(process.L, r, process, sum_v)
            carried = rests and equal
            if not carried:
                carry_factor(back, U[1 - at])
                at = 1 - at
                alike = alike + 1 if equal else 0
                rests = at_rest(U[at], rows + n, own.before, alike)
        if len(block_of) > 0:
            if linearisation == FILTERED:
                _shifted(y[k], innovation[k], H_pred[k], m[now], m_pred[k], own.y_hat)
                copy_matrix(H_pred[k], H[now])
            else:
                output_jacobian(m[now], u[k], p, own.y_hat, H[now])
            fresh = not (known and carried and same(H[now], H[later]))
            known = add_measured(y[k], own.y_hat, H[now], U[at], fresh, UR, block_of, sum_e, samples, measured)
    copy(m[0], m_end)
    copy_matrix(U[at], U_end)
    return dependent

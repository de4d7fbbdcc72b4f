"""The innovation test for outliers: which measurements a filter would turn away.

A measurement whose normalised innovation squared exceeds the chi-square quantile is not used for the update, so that
what follows it is judged by a state that it has not touched (Bar-Shalom, Li & Kirubarajan 2001, sec. 5.4).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numba import types
from numpy.typing import NDArray

from noiseid_cli.errors import EstimationError
from noiseid_cli.filters.ekf import NOT_FINITE, OK, SINGULAR_INNOVATION, FilterDivergedError
from noiseid_cli.filters.ekf_steps import predict, scratch, update
from noiseid_cli.filters.linalg import upper_factor
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.discretisation import transition, workspace
from noiseid_cli.models.jit import kernel, routine
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording
from noiseid_cli.models.signatures import DriftJacobian, OutputJacobian, matrix, vector


@dataclass(frozen=True)
class OutlierGate:
    """Options of the test.

    Attributes:
        probability: of turning away a good measurement, if the filter is right.
        per: ``sample`` tests the outputs of a sample together and turns away all of them; ``output`` tests each alone.
    """

    probability: float = 1e-6
    per: Literal["sample", "output"] = "sample"


@dataclass(frozen=True)
class Gated:
    """What the test found in one recording.

    Attributes:
        dropped: (N, ny) the measurements that were turned away.
        deviation: (N, ny) size of each measured innovation in its predicted standard deviations; NaN where missing.
    """

    dropped: NDArray[np.bool_]
    deviation: Array


def find_outliers(
    model: CompiledModel, recording: Recording, noise: NoiseValues, gate: OutlierGate, test: int = 0
) -> Gated:
    """Run the extended Kalman filter with the gate over one test.

    Args:
        model, recording, noise, test: as in ``ekf.extended_kalman_filter``.
        gate: the options.

    Raises:
        EstimationError: the probability is not between 0 and 1.
        FilterDivergedError: with the sample where it happened.
    """
    from scipy.special import chdtri

    if not 0.0 < gate.probability < 1.0:
        raise EstimationError(f"the outlier gate's probability is {gate.probability:g}; it must be between 0 and 1")
    ny = model.ny
    limits = np.concatenate(([np.inf], chdtri(np.arange(1, ny + 1), gate.probability)))
    dropped = np.zeros((recording.samples, ny), dtype=np.bool_)
    deviation = np.full((recording.samples, ny), np.nan)
    code, step = _gate(
        model.scheme,
        model.drift_jacobian,
        model.output_jacobian,
        model.parameters,
        np.ascontiguousarray(recording.dt),
        np.ascontiguousarray(recording.u),
        np.ascontiguousarray(recording.y),
        upper_factor(noise.Q, "the process noise covariance Q"),
        upper_factor(noise.R, "the measurement noise covariance R"),
        np.array(noise.m0[test], dtype=float),
        upper_factor(noise.P0, "the initial covariance P0"),
        limits,
        gate.per == "sample",
        dropped,
        deviation,
    )
    if code != OK:
        raise FilterDivergedError(code, step, recording)
    return Gated(dropped, deviation)


@kernel(
    types.UniTuple(types.int64, 2)(
        types.int64, DriftJacobian, OutputJacobian, vector, vector, matrix, matrix, matrix, matrix, vector, matrix,
        vector, types.boolean, types.boolean[:, ::1], matrix,
    ),
    allocates=True,
)  # fmt: skip
def _gate(  # type: ignore[no-untyped-def]
    scheme, drift_jacobian, output_jacobian, p, dt, u, y, UQ, UR, m, U, limits, together, dropped, deviation
):
    """Filter and test sample by sample; m and U are worked on, dropped and deviation are written."""
    n, nv, ny = len(m), len(UQ), len(UR)
    return _steps(
        scheme, drift_jacobian, output_jacobian, p, dt, u, y, UQ, UR, m, U, limits, together, dropped, deviation,
        np.empty(n), np.empty((n, n)), np.empty(ny), np.empty((ny, n)), np.empty(ny), np.empty((n, n)),
        np.empty((n, nv)), workspace(n, nv), scratch(n, nv, ny, False),
    )  # fmt: skip


@routine
def _steps(  # type: ignore[no-untyped-def]
    scheme, drift_jacobian, output_jacobian, p, dt, u, y, UQ, UR, m, U, limits, together, dropped, deviation,
    m_filt, U_filt, y_hat, H, nu, F, G, work, s,
):  # fmt: skip
    """The loop of ``_gate``; from m_filt on, all is scratch."""
    N, ny = y.shape
    n = len(m)
    for k in range(N):
        output_jacobian(m, u[k], p, y_hat, H)
        q = 0
        for i in range(ny):
            nu[i] = y[k, i] - y_hat[i]
            if math.isnan(y[k, i]):
                continue
            q += 1
            variance = 0.0
            for r in range(ny):
                variance += UR[r, i] * UR[r, i]
            for r in range(n):
                total = 0.0
                for c in range(r, n):
                    total += U[r, c] * H[i, c]
                variance += total * total
            deviation[k, i] = nu[i] / math.sqrt(variance)
            if not together and deviation[k, i] ** 2 > limits[1]:
                dropped[k, i] = True
        for i in range(ny):
            if dropped[k, i]:
                nu[i] = math.nan
        gain = update(m, U, H, nu, UR, m_filt, U_filt, s)
        if together and q > 0:
            size = 0.0
            for i in range(q):
                size += s.e[i] * s.e[i]
            if size > limits[q]:
                for i in range(ny):
                    dropped[k, i] = not math.isnan(y[k, i])
                    nu[i] = math.nan
                gain = update(m, U, H, nu, UR, m_filt, U_filt, s)
        if not math.isfinite(gain):
            return SINGULAR_INNOVATION if math.isnan(gain) else NOT_FINITE, k
        for i in range(n):
            if not math.isfinite(m_filt[i]) or not math.isfinite(U_filt[i, i]):
                return NOT_FINITE, k
        if k < N - 1:
            transition(scheme, drift_jacobian, m_filt, u[k], dt[k], p, m, F, G, work)
            predict(U_filt, F, G, UQ, U, s)
    return OK, N

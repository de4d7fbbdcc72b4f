"""The square-root unscented Kalman filter with additive noise, over a recording or sample by sample.

van der Merwe & Wan (2001); riva2017_sensitivity_asrukf, Tables 1 and 2 without the sensitivities. Order of steps: the
first sample is a correction of the prior; sigma points are redrawn before every correction; the process noise adds
F2 Q F2' with F2 taken at the filtered mean. For a linear model it is the Kalman filter, and so is the extended one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import types

from noiseid_cli.errors import EstimationError
from noiseid_cli.filters.ekf import NOT_FINITE, OK, FilterDivergedError, cube
from noiseid_cli.filters.linalg import upper_factor
from noiseid_cli.filters.sigma_points import SigmaWeights, draw, weighted_mean
from noiseid_cli.filters.sigma_steps import INDEFINITE_PREDICTION, condition, keep_observed, spread
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.discretisation import DENSITY, EXACT, advance, transition, workspace
from noiseid_cli.models.handle import borrowed, handle_type, new
from noiseid_cli.models.jit import kernel, routine
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording
from noiseid_cli.models.signatures import Drift, DriftJacobian, Output, matrix, vector


class _Filter(NamedTuple):
    """What the filter reads, its state between samples, and its scratch; see ``_new_filter`` for the shapes."""

    p: Array
    weights: Array  # eta, outer, cov0
    UQ: Array
    UR: Array
    u_before: Array  # (nu,) input before the next sample
    x: Array
    U: Array
    x_new: Array
    U_new: Array
    X: Array
    X_next: Array
    Y: Array
    y_hat: Array
    e: Array
    UR_seen: Array
    noise: Array
    F: Array
    G: Array
    Uyy: Array
    Pxy: Array
    K: Array
    W: Array
    w: Array
    d: Array
    v: Array
    work: Array
    lower: Array
    upper: Array
    observed: Array
    counts: Array  # corrections stacked, then (nx,) projections on bounds


_FILTER = types.NamedTuple(
    (vector, vector, matrix, matrix, vector,
     vector, matrix, vector, matrix, matrix, matrix, matrix, vector, vector, matrix, matrix, matrix, matrix, matrix,
     matrix, matrix, matrix, vector, vector, vector, vector, vector, vector, types.int64[::1], types.int64[::1]),
    _Filter,
)  # fmt: skip

_HANDLE = handle_type(scheme=types.int64, drift=Drift, drift_jacobian=DriftJacobian, output=Output, state=_FILTER)


@dataclass(frozen=True)
class SquareRootFiltered:
    """What the filter gives for one test; "pred" is k|k-1 and "filt" is k|k.

    Attributes:
        m_pred, m_filt: (N, nx) means.
        U_pred, U_filt: (N, nx, nx) upper factors, P = U'U.
        innovation: (N, ny) y[k] less the predicted output; NaN where y is missing.
        loglik: log-likelihood of the observed outputs, with the -m/2 log 2 pi term.
        restacked: number of corrections whose downdate failed and was replaced, see ``sigma_steps.condition``.
    """

    m_pred: Array
    U_pred: Array
    m_filt: Array
    U_filt: Array
    innovation: Array
    loglik: float
    restacked: int


class SquareRootUnscentedFilter:
    """The filter sample by sample, as it runs beside a machine.

    Attributes:
        samples: number of samples taken in.
        loglik: log-likelihood of all of them.
    """

    def __init__(
        self,
        model: CompiledModel,
        noise: NoiseValues,
        weights: SigmaWeights,
        added: Array | None = None,
        test: int = 0,
        bounds: tuple[Array, Array] | None = None,
    ) -> None:
        """Start from the prior of the first state.

        Args:
            model: the compiled model.
            noise: Q, R, P0 and m0, of which row ``test`` is used.
            weights: spread and weights of the sigma points of ``model.nx`` states.
            added: (nx, nx) covariance that each step adds to the state besides F2 Q F2'; none if not given.
            test: which row of ``noise.m0`` is the first mean.
            bounds: (nx,) least and largest values that the filtered mean is put back on; none if not given.

        Raises:
            EstimationError: a covariance is not symmetric positive semidefinite.
        """
        self._model = model
        own = np.zeros((0, model.nx)) if added is None else upper_factor(added, "the noise of the stacked states")
        self._state = s = _new_filter(model, own)
        s.p[:] = model.parameters
        s.weights[:] = weights.eta, weights.outer, weights.cov0
        s.UQ[:] = upper_factor(noise.Q, "the process noise covariance Q")
        s.UR[:] = upper_factor(noise.R, "the measurement noise covariance R")
        s.x[:] = noise.m0[test]
        s.U[:] = upper_factor(noise.P0, "the initial covariance P0")
        if bounds is not None:
            self._state.lower[:], self._state.upper[:] = bounds
        self._handle = _prepare(model.scheme, model.drift, model.drift_jacobian, model.output, s)
        self._y, self._u, self._dt = np.zeros((1, model.ny)), np.zeros((1, model.nu)), np.zeros(1)
        self._one = self._rows(1)
        self.samples = 0
        self.loglik = 0.0

    @property
    def restacked(self) -> int:
        """Number of corrections whose downdate failed and was replaced."""
        return int(self._state.counts[0])

    @property
    def projections(self) -> tuple[int, ...]:
        """How often the filtered mean of each state was put back on a bound."""
        return tuple(map(int, self._state.counts[1:]))

    @property
    def mean(self) -> Array:
        """(nx,) filtered mean at the last sample; the prior's before the first."""
        return self._state.x.copy()

    @property
    def factor(self) -> Array:
        """(nx, nx) upper factor of its covariance."""
        return self._state.U.copy()

    def step(self, y: Array, u: Array, dt: float = 0.0) -> tuple[Array, Array]:
        """Take in one sample.

        Args:
            y: (ny,) outputs; NaN where missing.
            u: (nu,) inputs, held until the next sample.
            dt: interval since the previous sample, s; not read at the first one.

        Returns:
            Filtered mean (nx,) and standard deviations (nx,).

        Raises:
            EstimationError: the filter failed; in words.
        """
        check_sample(y, u, self._model.ny, self._model.nu)
        self._y[0], self._u[0], self._dt[0] = y, u, dt
        code, done, loglik = _run(self._handle, self.samples == 0, self._dt, self._u, self._y, *self._one)
        self.samples += done
        self.loglik += loglik
        if code != OK:
            raise EstimationError(f"sample {self.samples + 1}: {FilterDivergedError.words(code)}")
        U = self._state.U
        return self._state.x.copy(), np.sqrt(np.einsum("ij,ij->j", U, U))

    def _rows(self, N: int) -> tuple[Array, Array, Array, Array, Array]:
        """Arrays for what N samples leave behind, in the order of ``SquareRootFiltered``."""
        n, ny = self._model.nx, self._model.ny
        return (np.empty((N, n)), np.empty((N, n, n)), np.empty((N, n)), np.empty((N, n, n)), np.empty((N, ny)))

    def take(self, y: Array, u: Array, dt: Array) -> tuple[int, int, SquareRootFiltered]:
        """Take in a block of samples.

        Args:
            y: (N, ny); u: (N, nu); dt: (N,) interval before each sample.

        Returns:
            A code of ``filters.ekf``, the number of samples taken in, and what the filter gives for them; rows that a
            failure did not reach are not set.
        """
        out = self._rows(len(y))
        before = self.restacked
        code, done, loglik = _run(self._handle, self.samples == 0, dt, u, y, *out)
        self.samples += done
        self.loglik += loglik
        return code, done, SquareRootFiltered(*out, loglik, self.restacked - before)


def check_sample(y: Array, u: Array, ny: int, nu: int) -> None:
    """Refuse a sample of another length than the model's.

    Raises:
        EstimationError: with both lengths.
    """
    if np.size(y) != ny or np.size(u) != nu:
        raise EstimationError(f"a sample has {np.size(y)} outputs, {np.size(u)} inputs; the model has {ny} and {nu}")


def square_root_unscented_filter(
    model: CompiledModel,
    recording: Recording,
    noise: NoiseValues,
    weights: SigmaWeights,
    test: int = 0,
    added: Array | None = None,
) -> SquareRootFiltered:
    """Filter one test.

    Args:
        model, noise, weights, test, added: see ``SquareRootUnscentedFilter``.
        recording: the test; NaN in y is a missing output.

    Raises:
        FilterDivergedError: with the sample where it happened.
        EstimationError: a covariance is not symmetric positive semidefinite.
    """
    online = SquareRootUnscentedFilter(model, noise, weights, added, test)
    dt = np.concatenate(([0.0], recording.dt))
    code, k, filtered = online.take(np.ascontiguousarray(recording.y), np.ascontiguousarray(recording.u), dt)
    if code != OK:
        raise FilterDivergedError(code, k, recording)
    return filtered


def _new_filter(model: CompiledModel, own: Array) -> _Filter:
    """Empty state and scratch; ``own`` are the noise rows that do not depend on the state."""
    n, nv, ny = model.nx, model.nv, model.ny
    wide = max(n, ny)
    noise = np.zeros((nv + len(own), n))
    noise[nv:] = own
    e = np.empty
    return _Filter(
        e(len(model.parameters)), e(3), e((nv, nv)), e((ny, ny)), np.zeros(model.nu),
        e(n), e((n, n)), e(n), e((n, n)), e((2 * n + 1, n)), e((2 * n + 1, n)), e((2 * n + 1, ny)), e(ny), e(ny),
        e((ny, ny)), noise, e((n, n)), e((n, nv)), e((ny, ny)), e((n, ny)), e((n, ny)),
        e((2 * n + max(ny, nv + len(own)), wide)), e(wide), e(wide), np.zeros(nv), workspace(n, nv),
        np.full(n, -np.inf), np.full(n, np.inf), np.empty(ny, dtype=np.int64), np.zeros(1 + n, dtype=np.int64),
    )  # fmt: skip


@routine
def _predict(scheme, drift, drift_jacobian, s, u, dt):  # type: ignore[no-untyped-def]
    """Time update of s.x, s.U over an interval (riva2017_sensitivity_asrukf, Table 1)."""
    n, nv = s.G.shape
    eta, outer, cov0, p = s.weights[0], s.weights[1], s.weights[2], s.p
    draw(s.x, s.U, eta, s.X)
    exact = scheme == EXACT or scheme == EXACT + DENSITY
    for i in range(2 * n + 1):
        if exact:
            transition(scheme, drift_jacobian, s.X[i], u, dt, p, s.X_next[i], s.F, s.G, s.work)
            continue
        advance(scheme, drift, s.X[i], u, s.v, dt, p, s.X_next[i], s.work)
    transition(scheme, drift_jacobian, s.x, u, dt, p, s.x_new, s.F, s.G, s.work)
    for r in range(nv):
        for c in range(n):
            total = 0.0
            for a in range(r, nv):
                total += s.UQ[r, a] * s.G[c, a]
            s.noise[r, c] = total
    weighted_mean(s.X_next, outer, s.x)
    return OK if spread(s.X_next, n, s.x, outer, cov0, s.noise, s.W, s.w, s.d, s.U) else INDEFINITE_PREDICTION


@kernel(_HANDLE(types.int64, Drift, DriftJacobian, Output, _FILTER))
def _prepare(scheme, drift, drift_jacobian, output, state):  # type: ignore[no-untyped-def]
    """The handle for ``_run``."""
    handle = new(_HANDLE)
    handle.scheme = scheme
    handle.drift = drift
    handle.drift_jacobian = drift_jacobian
    handle.output = output
    handle.state = state
    return handle


@kernel(
    types.Tuple((types.int64, types.int64, types.float64))(
        _HANDLE, types.boolean, vector, matrix, matrix, matrix, cube, matrix, cube, matrix,
    ),
)  # fmt: skip
def _run(handle, first, dt, u, y, m_pred, U_pred, m_filt, U_filt, innovation):  # type: ignore[no-untyped-def]
    """Take in the samples of y; the arrays from m_pred on are written. Returns (code, samples, loglik)."""
    scheme, drift, drift_jacobian, output = handle.scheme, handle.drift, handle.drift_jacobian, handle.output
    s = borrowed(handle.state)
    weights = s.weights
    n = s.x.shape[0]
    loglik = 0.0
    for k in range(y.shape[0]):
        if not (first and k == 0):
            code = _predict(scheme, drift, drift_jacobian, s, s.u_before, dt[k])
            if code != OK:
                return code, k, loglik
        m_pred[k], U_pred[k] = s.x, s.U
        draw(s.x, s.U, weights[0], s.X)
        for i in range(2 * n + 1):
            output(s.X[i], u[k], s.p, s.Y[i])
        weighted_mean(s.Y, weights[1], s.y_hat)
        innovation[k] = y[k] - s.y_hat
        q = keep_observed(y[k], s.Y, s.UR, s.observed, s.UR_seen)
        for b in range(q):
            s.y_hat[b] = s.y_hat[s.observed[b]]
            s.e[b] = innovation[k, s.observed[b]]
        code, gain, failed = condition(
            s.x, s.U, s.Y, q, s.y_hat, s.e, s.UR_seen, weights[0], weights[1], weights[2],
            s.x_new, s.U_new, s.Uyy, s.Pxy, s.K, s.W, s.w, s.d,
        )  # fmt: skip
        s.counts[0] += failed
        if code != OK:
            return code, k, loglik
        loglik += gain
        s.x[:], s.U[:, :] = s.x_new, s.U_new
        for i in range(n):
            if s.x[i] < s.lower[i] or s.x[i] > s.upper[i]:
                s.x[i] = min(max(s.x[i], s.lower[i]), s.upper[i])
                s.counts[1 + i] += 1
            if not math.isfinite(s.x[i]) or not math.isfinite(s.U[i, i]):
                return NOT_FINITE, k, loglik
        m_filt[k], U_filt[k] = s.x, s.U
        s.u_before[:] = u[k]
    return OK, y.shape[0], loglik

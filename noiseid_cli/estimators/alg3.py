"""Iterative covariance estimation from smoothed states (axelsson2011_poster, Alg. 3).

Smooth with Q_l, take v_k = F2^+(x_{k|N}) (x_{k+1|N} - F1(x_{k|N}, u_k)), and let Q_{l+1} be the sample covariance of v
over all steps of all tests, about its mean and with divisor (steps - 1). EM's M-step is the second moment of the same v
plus the smoothed covariance of the noise; this method leaves that out. It under-estimates Q therefore, and where the
outputs say little of a noise each step takes the larger part of its variance away, down to zero.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field

import numpy as np
from numba import types

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.data_check import check_data
from noiseid_cli.estimators.estimate import Estimate, Progress, Status
from noiseid_cli.estimators.unknowns import Unknowns
from noiseid_cli.filters.ekf import FilterDivergedError
from noiseid_cli.filters.linalg import left_solve
from noiseid_cli.filters.smoother import extended_kalman_smoother, filter_to_smooth
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.discretisation import transition, workspace
from noiseid_cli.models.jit import kernel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording
from noiseid_cli.models.signatures import DriftJacobian, matrix, vector

# A standard deviation is called nearly gone below this share of its start, or of what the other noises leave of it.
NEARLY_GONE = 1e-2


@dataclass(frozen=True)
class Alg3Options:
    """Options of ``estimate``.

    Attributes:
        max_passes: give up after so many passes over the data.
        parameter_tolerance: stop when a step changes no log standard deviation and no correlation by more than this.
        zero_tolerance: stop when a standard deviation falls below this share of its start, or the square root of an
            eigenvalue of the correlations below this: it would not come back.
    """

    max_passes: int = 500
    parameter_tolerance: float = 1e-5
    zero_tolerance: float = 1e-6


@dataclass
class _Run:
    """One run over the data: counts passes and keeps the trace."""

    model: CompiledModel
    recordings: Sequence[Recording]
    unknowns: Unknowns
    options: Alg3Options
    progress: Progress | None
    points: list[NoiseValues] = field(default_factory=list)
    logliks: list[float] = field(default_factory=list)
    changes: list[float] = field(default_factory=list)
    singular: int = 0

    def visit(self, noise: NoiseValues) -> NoiseValues:
        """One pass at ``noise``; returns the values of the next step."""
        assert self.unknowns.Q is not None
        v, loglik, singular = smoothed_noise(self.model, self.recordings, noise)
        sample = np.atleast_2d(np.cov(v, rowvar=False))
        after = NoiseValues(self.unknowns.Q.maximise(sample, noise.Q), noise.R, noise.m0, noise.P0)
        self.points.append(noise)
        self.logliks.append(loglik)
        self.changes.append(self.unknowns.change(noise, after))
        self.singular += singular
        if self.progress is not None:
            self.progress(len(self.points), loglik)
        return after


def estimate(
    model: CompiledModel,
    recordings: Sequence[Recording],
    start: NoiseValues,
    unknowns: Unknowns,
    options: Alg3Options | None = None,
    progress: Progress | None = None,
) -> Estimate:
    """Identify the process noise covariance by Alg. 3.

    Args:
        model: the compiled model; the columns of F2 must be independent.
        recordings: the tests; lengths, intervals and missing outputs may differ.
        start: noise values to start from; all but Q stay as they are.
        unknowns: the structure of Q; nothing else can be unknown.
        options: see ``Alg3Options``.
        progress: called after each pass.

    Returns:
        The estimate; its ``final`` is the last iterate, whatever the log-likelihood did on the way.

    Raises:
        EstimationError: the problem cannot be posed (something else than Q unknown, singular start, too few samples,
            dependent noise gains).
        FilterDivergedError: the filter fails at the start itself.
    """
    options = options or Alg3Options()
    _check(model, recordings, start, unknowns)
    began = time.perf_counter()
    run = _Run(model, recordings, unknowns, options, progress)
    status, reason = _iterate(run, start)
    return Estimate(
        method="alg3",
        status=status,
        reason=reason,
        start=start,
        final=run.points[-1],
        loglik_start=run.logliks[0],
        loglik=run.logliks[-1],
        passes=len(run.points),
        seconds=time.perf_counter() - began,
        trace=_trace(run),
        safeguards=tuple(_safeguards(run)),
        settings=asdict(options),
    )


def smoothed_noise(
    model: CompiledModel, recordings: Sequence[Recording], noise: NoiseValues
) -> tuple[Array, float, int]:
    """The process noise that carries each smoothed state to the next (axelsson2011_poster, Alg. 3, steps 2 and 3).

    Returns:
        (steps of all tests, nv) noises v_k, the log-likelihood, and the number of singular predictions.

    Raises:
        FilterDivergedError: the filter failed; with test and sample.
        EstimationError: F2 lacks full column rank; with test and sample.
    """
    parts, loglik, singular = [], 0.0, 0
    for i, recording in enumerate(recordings):
        forward = filter_to_smooth(model, recording, noise, i)
        smoothed = extended_kalman_smoother(forward)
        v = np.empty((recording.samples - 1, model.nv))
        dt, u = np.ascontiguousarray(recording.dt), np.ascontiguousarray(recording.u)
        dependent = _noise(model.scheme, model.drift_jacobian, model.parameters, dt, u, smoothed.m, v)
        if dependent >= 0:
            raise EstimationError(
                f"test {recording.name!r}, sample {dependent + 1}: the columns of the noise gain F2 are linearly "
                "dependent, so that the data cannot tell the process noises apart; drop one of them"
            )
        parts.append(v)
        loglik += forward.loglik
        singular += forward.singular
    return np.concatenate(parts), loglik, singular


def _check(model: CompiledModel, recordings: Sequence[Recording], start: NoiseValues, unknowns: Unknowns) -> None:
    """Refuse what the method has no answer for."""
    check_data(model, recordings)
    others = {"measurement_noise": unknowns.R, "initial_covariance": unknowns.P0, "initial_mean": unknowns.m0}
    for name, unknown in others.items():
        if unknown:
            raise EstimationError(
                f"alg3 estimates the process noise only: give {name} as known, or use em, which estimates both"
            )
    unknowns.check(start)
    steps = sum(r.samples - 1 for r in recordings)
    if steps <= model.nv:
        raise EstimationError(
            f"{steps} steps give no regular sample covariance of {model.nv} noises: alg3 needs {model.nv + 1} at least"
        )


def _iterate(run: _Run, start: NoiseValues) -> tuple[Status, str]:
    """Steps until the values rest, vanish, or the filter fails."""
    after = run.visit(start)
    while run.changes[-1] > run.options.parameter_tolerance:
        vanished = _vanished(after.Q, start.Q, run.options.zero_tolerance)
        if vanished:
            return "stalled_fixed_point", (
                f"after {len(run.points)} passes {vanished}: zero is a fixed point of this method, and it is drawn "
                "there where the outputs say little of a noise, because it leaves out the smoothed covariance; the "
                "last values before it are kept; em does not leave it out"
            )
        if len(run.points) >= run.options.max_passes:
            return "max_passes", (
                f"{len(run.points)} passes were not enough: the last step still changes a log standard deviation or a "
                f"correlation by {run.changes[-1]:.2g}"
            )
        try:
            after = run.visit(after)
        except FilterDivergedError as error:
            return "diverged", f"after {len(run.points)} passes {error}; the last values before it are kept"
    return "converged", (
        f"after {len(run.points)} passes the last step changed no log standard deviation and no correlation by more "
        f"than {run.changes[-1]:.2g}"
    )


def _vanished(Q: Array, start: Array, tolerance: float) -> str:
    """Which standard deviation is below ``tolerance``, in words; empty if none."""
    scale = np.sqrt(np.diag(Q))
    share = scale / np.sqrt(np.diag(start))
    least = int(np.argmin(share))
    if share[least] < tolerance:
        return f"the standard deviation of noise {least + 1} is {share[least]:.2g} of its start"
    smallest = float(np.linalg.eigvalsh(Q / np.outer(scale, scale))[0])
    return f"the smallest eigenvalue of the correlations of Q is {smallest:.2g}" if smallest < tolerance**2 else ""


def _trace(run: _Run) -> dict[str, Array]:
    passes = len(run.points)
    return {
        "loglik": np.array(run.logliks),
        "Q": np.array([n.Q for n in run.points]),
        "R": np.array([n.R for n in run.points]),
        "change": np.array(run.changes),
        "extrapolated": np.zeros(passes),
        "accepted": np.ones(passes),
    }


def _safeguards(run: _Run) -> list[str]:
    """Each warning about the end, in a sentence."""
    out = []
    if run.singular:
        out.append(f"{run.singular} predicted covariances were singular (a state was exactly known)")
    gone = _vanished(run.points[-1].Q, run.points[0].Q, NEARLY_GONE)
    if gone:
        out.append(
            f"at the end {gone}: this method leaves out the smoothed covariance, so that what the outputs say little "
            "of shrinks towards zero"
        )
    return out


@kernel(types.int64(types.int64, DriftJacobian, vector, vector, matrix, matrix, matrix), allocates=True)
def _noise(scheme, drift_jacobian, p, dt, u, m, v):  # type: ignore[no-untyped-def]
    """Write v_k = F2^+(m_k) (m_{k+1} - F1(m_k, u_k)). Returns the sample where F2 lacks full column rank, or -1."""
    N, n = m.shape
    nv = v.shape[1]
    if nv > n:
        return 0
    x_next = np.empty(n)
    J1 = np.empty((n, n))
    F2 = np.empty((n, nv))
    work = workspace(n, nv)
    L, pivot_column = np.empty((n, nv + 1)), np.empty(nv, dtype=np.int64)
    for k in range(N - 1):
        transition(scheme, drift_jacobian, m[k], u[k], dt[k], p, x_next, J1, F2, work)
        for i in range(n):
            for c in range(nv):
                L[i, c] = F2[i, c]
            L[i, nv] = m[k + 1, i] - x_next[i]
        if not left_solve(L, nv, nv + 1, pivot_column):
            return k
        for c in range(nv):
            v[k, c] = L[c, nv]
    return -1

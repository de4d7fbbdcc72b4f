"""The E-step of EM: smooth every test and gather what the M-steps need.

Filter and smoother work on factors; the expected second moments of v and e are sums of products of their rows, from
which nothing is subtracted, so that every M-step is symmetric and positive semidefinite by construction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.extended_moments import FILTERED, LINEARISATIONS, SMOOTHED, gather_back
from noiseid_cli.estimators.sigma_moments import measurement_sigma, process_sigma
from noiseid_cli.filters.linalg import upper_factor
from noiseid_cli.filters.segments import forward_parts
from noiseid_cli.filters.sigma_filter import sigma_point_filter
from noiseid_cli.filters.sigma_points import SigmaWeights
from noiseid_cli.filters.sigma_rows import pair_centre
from noiseid_cli.filters.sigma_smoother import sigma_point_smoother
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording
from noiseid_cli.models.threads import in_threads

__all__ = ["FILTERED", "LINEARISATIONS", "SMOOTHED", "Statistics", "e_step"]


@dataclass(frozen=True)
class Statistics:
    """What one pass over the data gives.

    Attributes:
        loglik: log-likelihood of all tests under the values of the pass.
        sum_v: (nv, nv) sum over steps of E[v v' | y]; steps: number of steps.
        sum_e: (ny, ny) sum over samples of E[e e' | y], nothing being added where a block was not measured.
        samples: (ny,) number of samples that count for each output.
        m_first: (tests, nx) smoothed mean and U_first: (tests, nx, nx) factor of the first state.
        singular: number of singular predictions, see ``Smoothed``.
    """

    loglik: float
    sum_v: Array
    steps: int
    sum_e: Array
    samples: Array
    m_first: Array
    U_first: Array
    singular: int

    @property
    def moment_v(self) -> Array:
        """(nv, nv) mean of E[v v' | y]: the M-step of an unstructured Q."""
        return self.sum_v / self.steps

    @property
    def moment_e(self) -> Array:
        """(ny, ny) mean of E[e e' | y]; entries of outputs that were never measured are NaN."""
        s = np.sqrt(self.samples)
        with np.errstate(invalid="ignore"):
            moment: Array = self.sum_e / np.outer(s, s)
        return moment


def e_step(
    model: CompiledModel,
    recordings: Sequence[Recording],
    noise: NoiseValues,
    linearisation: int = SMOOTHED,
    block_of: np.ndarray[tuple[int], np.dtype[np.int64]] | None = None,
    weights: SigmaWeights | None = None,
) -> Statistics:
    """One pass: filter, smooth, and accumulate over all tests (axelsson2011_poster, E-step; METHODS 2).

    Args:
        model, recordings, noise: the problem.
        linearisation: SMOOTHED takes F1 and its Jacobian anew at the smoothed states, as the paper does; FILTERED uses
            the filter's own linearisation, under which the statistics are those of the likelihood that it reports.
        block_of: (ny,) block of each output; a block of R is completed or left out as one where outputs are missing.
            Without it the measurement statistics are not gathered.
        weights: those of a sigma-point filter and smoother, under whose smoothed distribution the moments are then
            taken, see ``sigma_moments``; ``linearisation`` is not read. Without them the extended ones.

    Raises:
        EstimationError: the columns of F2 are linearly dependent somewhere.
        FilterDivergedError: the filter failed; with test and sample.
    """
    UR = upper_factor(noise.R, "the measurement noise covariance R")

    def smooth(test: int) -> _Gather:
        own = _Gather.empty(model)
        if weights is None:
            _extended(own, model, recordings[test], noise, UR, test, linearisation, block_of)
        else:
            _sigma_points(own, model, recordings[test], noise, UR, test, weights, block_of)
        return own

    # Each test has sums of its own, which are added up in order: any number of threads gives the same bits.
    found = in_threads(smooth, range(len(recordings)))
    total = found[0]
    for own in found[1:]:
        total.join(own)
    m_first, U_first = np.array([own.m_first for own in found]), np.array([own.U_first for own in found])
    return Statistics(
        total.loglik, total.sum_v, total.steps, total.sum_e, total.samples, m_first, U_first, total.singular
    )


@dataclass
class _Gather:
    """The sums of ``Statistics`` over one test, while they grow."""

    sum_v: Array
    sum_e: Array
    samples: Array
    m_first: Array
    U_first: Array
    loglik: float = 0.0
    steps: int = 0
    singular: int = 0

    @classmethod
    def empty(cls, model: CompiledModel) -> _Gather:
        nx, nv, ny = model.nx, model.nv, model.ny
        return cls(np.zeros((nv, nv)), np.zeros((ny, ny)), np.zeros(ny), np.empty(nx), np.empty((nx, nx)))

    def add(self, loglik: float, singular: int, steps: int, m_first: Array, U_first: Array) -> None:
        self.loglik += loglik
        self.singular += singular
        self.steps += steps
        self.m_first, self.U_first = m_first.copy(), U_first.copy()

    def join(self, other: _Gather) -> None:
        """Take in the sums of another test."""
        self.loglik += other.loglik
        self.singular += other.singular
        self.steps += other.steps
        self.samples += other.samples
        self.sum_v += other.sum_v
        self.sum_e += other.sum_e


Blocks = np.ndarray[tuple[int], np.dtype[np.int64]]


def _extended(
    gather: _Gather, model: CompiledModel, recording: Recording, noise: NoiseValues, UR: Array, test: int,
    linearisation: int, block_of: Blocks | None,
) -> None:  # fmt: skip
    """Add one test, by the extended Kalman smoother."""
    blocks = np.empty(0, dtype=np.int64) if block_of is None else block_of
    end: tuple[Array, Array] | None = None
    for part, f in forward_parts(model, recording, noise, test):
        end = end or (f.m_filt[-1].copy(), f.U_filt.copy())
        dt, u, y = (np.ascontiguousarray(a) for a in (part.dt, part.u, part.y))
        dependent = gather_back(
            model.scheme, model.drift_jacobian, model.output_jacobian, model.parameters, dt, u, y, UR,
            f.m_pred, f.m_filt, f.gain_t, f.C, f.source, f.H, f.innovation,
            linearisation, blocks, *end, gather.sum_v, gather.sum_e, gather.samples,
        )  # fmt: skip
        _refuse_dependent(part, dependent)
        gather.add(f.loglik, f.singular, part.samples - 1, *end)
        del part, f  # before the next one is made


def _sigma_points(
    gather: _Gather, model: CompiledModel, recording: Recording, noise: NoiseValues, UR: Array, test: int,
    weights: SigmaWeights, block_of: Blocks | None,
) -> None:  # fmt: skip
    """Add one test, by the sigma-point smoother."""
    filtered = sigma_point_filter(model, recording, noise, weights, test)
    smoothed = sigma_point_smoother(filtered)
    gather.add(filtered.loglik, filtered.singular, len(smoothed.m) - 1, smoothed.m[0], smoothed.U[0])
    centre = pair_centre(weights, model.nx)
    dt, u, y = (np.ascontiguousarray(a) for a in (recording.dt, recording.u, recording.y))
    dependent = process_sigma(
        model.scheme, model.drift_jacobian, model.parameters, dt, u, weights.eta, centre,
        smoothed.m, smoothed.U, smoothed.T, smoothed.V, gather.sum_v,
    )  # fmt: skip
    _refuse_dependent(recording, dependent)
    if block_of is not None:
        measurement_sigma(
            model.output, model.parameters, u, y, weights.eta, centre, smoothed.m, smoothed.U, UR, block_of,
            gather.sum_e, gather.samples,
        )  # fmt: skip


def _refuse_dependent(recording: Recording, sample: int) -> None:
    """Raise the error for a noise gain without full column rank at this sample, from 0; -1 for none."""
    if sample >= 0:
        raise EstimationError(
            f"test {recording.name!r}, sample {sample + 1}: the columns of the noise gain F2 are linearly "
            "dependent, so that the data cannot tell the process noises apart; drop one of them"
        )

"""The E-step of EM: smooth every test and gather what the M-steps need, in square-root form.

The expected second moments of v and e are accumulated as triangular factors (each sample adds rows, one
triangularisation absorbs them), so that every M-step is symmetric and positive semidefinite by construction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.measurement_moment import FILTERED, LINEARISATIONS, SMOOTHED, measurement
from noiseid_cli.estimators.process_moment import process_filtered, process_smoothed
from noiseid_cli.filters.ekf import extended_kalman_filter
from noiseid_cli.filters.linalg import upper_factor
from noiseid_cli.filters.smoother import extended_kalman_smoother
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording

__all__ = ["FILTERED", "LINEARISATIONS", "SMOOTHED", "Statistics", "e_step"]


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
            process_filtered(filtered.m_pred, smoothed.m, smoothed.U, smoothed.gain, smoothed.C, U_v)
        else:
            dependent = process_smoothed(
                model.scheme, model.drift_jacobian, model.parameters, dt, u,
                smoothed.m, smoothed.U, smoothed.gain, smoothed.C, U_v,
            )  # fmt: skip
            if dependent >= 0:
                raise EstimationError(
                    f"test {recording.name!r}, sample {dependent + 1}: the columns of the noise gain F2 are linearly "
                    "dependent, so that the data cannot tell the process noises apart; drop one of them"
                )
        if block_of is not None:
            measurement(
                model.output_jacobian, model.parameters, u, y, filtered.m_pred, filtered.H, filtered.innovation,
                smoothed.m, smoothed.U, UR, block_of, linearisation, U_e, samples,
            )  # fmt: skip
    return Statistics(loglik, U_v, steps, U_e, samples, m_first, U_first, singular)

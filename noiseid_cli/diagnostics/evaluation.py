"""The figures that say how well a filter with given noise covariances agrees with recordings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from noiseid_cli.diagnostics.where import Misfit
from noiseid_cli.models.recording import Array


@dataclass(frozen=True)
class Evaluation:
    """One filter, with one set of noise values, run over one dataset.

    Attributes:
        label: which noise values: ``start``, ``estimate`` or ``truth``.
        loglik: log-likelihood, with the -m/2 log 2 pi term.
        observed: number of scalar measurements that were used.
        nis: mean normalised innovation squared per scalar measurement; 1 for a consistent filter.
        nis_output: (ny,) mean of nu_i^2 / S_ii per output; 1 for a consistent filter.
        autocorrelation: (lags, ny) autocorrelation of the normalised innovations nu_i / sqrt(S_ii), lags 1, 2, ...
        ljung_box: (ny,) p-value of the Ljung-Box test over those lags; small means coloured innovations.
        kurtosis: (ny,) excess kurtosis of the normalised innovations; 0 for Gaussian ones.
        path_error: (samples of all tests,) distance between estimated and true performance output, in the output's
            unit; None where no true one is known.
        path_error_norm: its 2-norm over time; NaN where no true one is known.
        nis_time: (samples of all tests,) normalised innovation squared per measurement, NaN where nothing was measured.
        filter: the Kalman filter that was run: ``extended``, ``unscented`` or ``cubature``.
        inside: (ny,) share of innovations within their own band of 95 %, 1.96 standard deviations to each side.
        normality: (ny,) p-value of the test of Jarque & Bera (1987) on the normalised innovations; small for a
            distribution that is not Gaussian.
        nees: mean normalised estimation error squared per state, 1 for a consistent filter; NaN without a truth.
        nees_time: (samples of all tests,) the same over time; None where no truth is known.
        states: number of states, for the bounds of ``nees_time``.
        misfit: the NIS against time, states and inputs.
    """

    label: str
    loglik: float
    observed: int
    nis: float
    nis_output: Array
    autocorrelation: Array
    ljung_box: Array
    kurtosis: Array
    path_error: Array | None
    path_error_norm: float
    nis_time: Array
    filter: str = "extended"
    inside: Array | None = None
    normality: Array | None = None
    nees: float = float("nan")
    nees_time: Array | None = None
    states: int = 0
    misfit: tuple[Misfit, ...] = ()

    def nis_bounds(self, level: float = 0.95) -> tuple[float, float]:
        """Bounds of the mean NIS of a consistent filter: chi-square with as many degrees as measurements, over them."""
        from scipy.special import chdtri

        tail, n = 0.5 * (1.0 - level), float(self.observed)
        if n == 0:
            return 0.0, float("inf")
        return float(chdtri(n, 1.0 - tail)) / n, float(chdtri(n, tail)) / n

    def nees_inside(self, level: float = 0.95) -> float:
        """Share of samples at which the NEES is between its chi-square bounds; NaN where no truth is known.

        Estimation errors are correlated over time: the bounds hold sample by sample, not for the mean.
        """
        from scipy.special import chdtri

        if self.nees_time is None or not np.isfinite(self.nees_time).any():
            return float("nan")
        tail, n = 0.5 * (1.0 - level), float(self.states)
        found = n * self.nees_time[np.isfinite(self.nees_time)]
        return float(np.mean((found >= chdtri(n, 1.0 - tail)) & (found <= chdtri(n, tail))))

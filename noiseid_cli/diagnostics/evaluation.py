"""The figures that say how well a filter with given noise covariances agrees with recordings."""

from __future__ import annotations

from dataclasses import dataclass

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

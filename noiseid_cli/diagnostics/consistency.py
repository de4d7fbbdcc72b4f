"""Does a filter agree with the recordings: size, whiteness and tails of its innovations.

Convention: the innovations nu of a filter that is right have mean zero and covariance S, and are white. So
nothing here removes a mean: a constant offset is a misfit, and shows as correlation at every lag.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from noiseid_cli.diagnostics.evaluation import Evaluation
from noiseid_cli.errors import EstimationError
from noiseid_cli.models.recording import Array

BAND = 1.959964
"""Half-width of the band of 95 % of a normal distribution, in standard deviations."""


def consistency(
    label: str,
    nu: Sequence[Array],
    S: Sequence[Array],
    loglik: float,
    path_error: Sequence[Array] | None = None,
    lags: int = 20,
) -> Evaluation:
    """Measure how well the innovations of a filter agree with the covariance that it gave for them.

    Args:
        label: which noise values the filter had: ``start``, ``estimate`` or ``truth``.
        nu: per test, (N, ny) innovations; NaN where an output is missing.
        S: per test, (N, ny, ny) innovation covariances; rows and columns of missing outputs are not read.
        loglik: log-likelihood of the filter over all tests.
        path_error: per test, (N,) distance to the true performance output; None where that is not known.
        lags: number of lags of the autocorrelation and of the Ljung-Box test.

    Raises:
        EstimationError: an innovation covariance is not positive definite; names the test and the sample.
    """
    if lags < 1:
        raise EstimationError(f"lags is {lags}; the autocorrelation needs at least 1.")
    parts = [_normalise(label, i, nu_i, S_i) for i, (nu_i, S_i) in enumerate(zip(nu, S, strict=True))]
    normalised = [r for r, _ in parts]
    joint = np.concatenate([d for _, d in parts])
    stacked = np.concatenate(normalised)
    counts = np.isfinite(stacked).sum(axis=1)
    observed = int(counts.sum())
    rho, p_value = autocorrelation(normalised, lags)
    error = None if path_error is None else np.concatenate(list(path_error))
    return Evaluation(
        label=label,
        loglik=float(loglik),
        observed=observed,
        nis=float(joint.sum() / observed) if observed else float("nan"),
        nis_output=_mean_or_nan(stacked**2),
        autocorrelation=rho,
        ljung_box=p_value,
        kurtosis=_excess_kurtosis(stacked),
        path_error=error,
        path_error_norm=float("nan") if error is None else float(np.sqrt(np.sum(error**2))),
        inside=_mean_or_nan(np.where(np.isfinite(stacked), (np.abs(stacked) <= BAND).astype(float), np.nan)),
        normality=_jarque_bera(stacked),
        nis_time=np.divide(joint, counts, out=np.full(len(joint), np.nan), where=counts > 0),
    )


def _normalise(label: str, test: int, nu: Array, S: Array) -> tuple[Array, Array]:
    """Return nu_i / sqrt(S_ii), NaN where missing, and nu' S^-1 nu over the observed rows of each sample.

    A missing row becomes a row of the identity with innovation zero, which leaves the sum of the others as it
    is. Scaling to unit diagonal first keeps outputs of very different units apart in the factorisation.
    """
    seen = np.isfinite(nu)
    both = seen[:, :, None] & seen[:, None, :]
    used = np.where(both, S, np.eye(nu.shape[1]))
    variance = np.diagonal(used, axis1=1, axis2=2)
    bad = np.flatnonzero(~(np.isfinite(used).all(axis=(1, 2)) & (variance > 0).all(axis=1)))
    if bad.size:
        raise _not_positive(label, test, int(bad[0]), S)
    scale = np.sqrt(variance)
    C = used / (scale[:, :, None] * scale[:, None, :])
    r = np.where(seen, nu, 0.0) / scale
    try:
        chol_C = np.linalg.cholesky(C)
    except np.linalg.LinAlgError:
        worst = int(np.argmin(np.linalg.eigvalsh(C).min(axis=1)))
        raise _not_positive(label, test, worst, S) from None
    white = np.linalg.solve(chol_C, r[:, :, None])[:, :, 0]
    return np.where(seen, r, np.nan), np.sum(white**2, axis=1)


def _not_positive(label: str, test: int, sample: int, S: Array) -> EstimationError:
    shown = " ".join(np.array2string(S[sample], precision=3).split())  # in one line
    return EstimationError(
        f"The filter at the {label} values has an innovation covariance that is not positive definite: test "
        f"{test + 1}, sample {sample + 1}, S = {shown}. The filter has diverged or R is singular: look at R, and at "
        "the start values."
    )


def autocorrelation(normalised: Sequence[Array], lags: int) -> tuple[Array, Array]:
    """Autocorrelation at lags 1, 2, ... and the p-value of the Ljung-Box test, both per output.

    Pairs are formed inside a test and only where both values are there; with n values and n_k pairs, rho_k is
    the mean product over the pairs divided by the mean square over all values. For white Gaussian innovations
    E rho_k^2 = n / (n_k (n + 2)) exactly, gaps or not, so that sum_k rho_k^2 n_k (n + 2) / n has mean
    ``lags``; without gaps it is the statistic of Ljung & Box (1978), eq. 1.1.

    Args:
        normalised: per test, (N, ny) normalised innovations, NaN where missing.
        lags: number of lags.

    Returns:
        (lags, ny) autocorrelation, NaN at a lag without pairs; (ny,) p-values, NaN without any pair.
    """
    from scipy.special import chdtrc

    ny = normalised[0].shape[1]
    n, power = np.zeros(ny), np.zeros(ny)
    pairs, products = np.zeros((lags, ny)), np.zeros((lags, ny))
    for r in normalised:
        seen = np.isfinite(r)
        filled = np.where(seen, r, 0.0)
        n += seen.sum(axis=0)
        power += np.sum(filled**2, axis=0)
        for k in range(1, min(lags, len(r) - 1) + 1):
            pairs[k - 1] += np.sum(seen[k:] & seen[:-k], axis=0)
            products[k - 1] += np.sum(filled[k:] * filled[:-k], axis=0)
    known = (pairs > 0) & (power > 0)
    rho = np.full((lags, ny), np.nan)
    np.divide(products * n, pairs * power, out=rho, where=known)
    weight = np.divide(pairs * (n + 2), n, out=np.zeros_like(pairs), where=known)
    statistic = np.sum(np.where(known, rho, 0.0) ** 2 * weight, axis=0)
    freedom = known.sum(axis=0)
    p_value = np.where(freedom > 0, chdtrc(np.maximum(freedom, 1), statistic), np.nan)
    return rho, np.asarray(p_value, dtype=np.float64)


def _mean_or_nan(values: Array) -> Array:
    """Mean of each column over the finite values; NaN for a column without any."""
    seen: NDArray[np.bool_] = np.isfinite(values)
    count = seen.sum(axis=0)
    total = np.where(seen, values, 0.0).sum(axis=0)
    mean: Array = np.divide(total, count, out=np.full(values.shape[1], np.nan), where=count > 0)
    return mean


def _standardised(r: Array) -> Array:
    """Each column less its mean, over its largest deviation: powers of it neither overflow nor vanish."""
    centred = r - _mean_or_nan(r)
    largest = np.max(np.abs(centred), axis=0, initial=0.0, where=np.isfinite(centred))
    scaled: Array = np.divide(centred, largest, out=np.zeros_like(centred), where=largest > 0)
    return np.where(np.isfinite(r), scaled, np.nan)


def _excess_kurtosis(r: Array) -> Array:
    """Fourth central moment over the squared second, minus 3, per column; NaN for a constant column."""
    centred = _standardised(r)
    m2, m4 = _mean_or_nan(centred**2), _mean_or_nan(centred**4)
    usable = np.isfinite(m2) & (m2 > 0)
    ratio: Array = np.divide(m4, m2**2, out=np.full(r.shape[1], np.nan), where=usable)
    return ratio - 3.0


def _jarque_bera(r: Array) -> Array:
    """P-value of n/6 (skewness^2 + excess kurtosis^2 / 4) as chi-square with two degrees (Jarque & Bera 1987)."""
    centred = _standardised(r)
    n = np.isfinite(r).sum(axis=0)
    m2, m3 = _mean_or_nan(centred**2), _mean_or_nan(centred**3)
    usable = np.isfinite(m2) & (m2 > 0)
    skewness = np.divide(m3, m2**1.5, out=np.full(r.shape[1], np.nan), where=usable)
    p: Array = np.exp(-0.5 * n / 6.0 * (skewness**2 + _excess_kurtosis(r) ** 2 / 4.0))
    return p

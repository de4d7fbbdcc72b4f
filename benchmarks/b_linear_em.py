"""(b) One pass of linear EM for Q and R (n 5, m 2), both full.

statsmodels has no M-step for a model given by matrices: its smoother alone is timed, with the covariances that an
M-step needs. simdkalman is made for many series at once and is given one, like the others; its EM reads the lag-one
covariance one sample off, so that its Q is another: the row says how far. What the others give is compared with ours
before anything is timed.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from timing import Work, checked, compared, peer, side_by_side

from noiseid_cli.estimators.em_statistics import e_step
from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.estimators.unknowns import Unknowns
from noiseid_cli.models.linear import linear_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording

SAMPLES = (500, 20000)


def problem(samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, NoiseValues]:
    """A, C, y and noise values of a stable random system."""
    rng = np.random.default_rng(5)
    A, C = rng.normal(size=(5, 5)), rng.normal(size=(2, 5))
    A *= 0.95 / np.abs(np.linalg.eigvals(A)).max()
    x, y = np.zeros(5), np.empty((samples, 2))
    for k in range(samples):
        y[k] = C @ x + rng.normal(size=2)
        x = A @ x + 0.3 * rng.normal(size=5)
    return A, C, y, NoiseValues(0.1 * np.eye(5), np.eye(2), np.zeros((1, 5)), np.eye(5))


def noiseid(samples: int) -> tuple[Callable[[], NoiseValues], float]:
    """E-step and M-step; and the log-likelihood."""
    A, C, y, noise = problem(samples)
    model = linear_model(A, np.eye(5), C)
    recording = Recording("test", np.ones(samples - 1), np.zeros((samples, 0)), y)
    unknowns = Unknowns(Q=CovarianceStructure.full(noise.Q), R=CovarianceStructure.full(noise.R))
    assert unknowns.R is not None
    blocks = unknowns.R.block_of

    def run() -> NoiseValues:
        return unknowns.maximise(e_step(model, [recording], noise, block_of=blocks), noise)

    return run, e_step(model, [recording], noise).loglik


def pykalman(samples: int) -> Work:
    """One iteration of its ``em``."""
    from pykalman import KalmanFilter

    A, C, y, noise = problem(samples)

    def run() -> object:
        kalman = KalmanFilter(A, C, noise.Q, noise.R, np.zeros(5), np.zeros(2), noise.m0[0], noise.P0)
        return kalman.em(y, n_iter=1, em_vars=["transition_covariance", "observation_covariance"])

    return run


def statsmodels(samples: int) -> Work:
    """Its compiled smoother."""
    from statsmodels.tsa.statespace.kalman_smoother import (
        SMOOTHER_STATE,
        SMOOTHER_STATE_AUTOCOV,
        SMOOTHER_STATE_COV,
        KalmanSmoother,
    )

    A, C, y, noise = problem(samples)
    smoother = KalmanSmoother(k_endog=2, k_states=5, k_posdef=5)
    smoother.bind(np.asfortranarray(y.T))
    for name, value in (("design", C), ("transition", A), ("selection", np.eye(5)), ("state_cov", noise.Q),
                        ("obs_cov", noise.R)):  # fmt: skip
        smoother[name] = value
    smoother.initialize_known(noise.m0[0], noise.P0)
    wanted = SMOOTHER_STATE | SMOOTHER_STATE_COV | SMOOTHER_STATE_AUTOCOV
    return lambda: smoother.smooth(smoother_output=wanted)


def simdkalman(samples: int) -> Work:
    """One iteration of its ``em``."""
    from simdkalman import KalmanFilter

    A, C, y, noise = problem(samples)
    kalman = KalmanFilter(A, noise.Q, C, noise.R)
    return lambda: kalman.em(y[None], n_iter=1, initial_value=noise.m0[:, :, None], initial_covariance=noise.P0)


def off(found: np.ndarray, ours: np.ndarray) -> float:
    """Largest difference, relative to the largest entry."""
    return float(np.abs(found - ours).max() / np.abs(ours).max())


def works_of(samples: int) -> dict[str, Work | str]:
    """All programs whose answer is noiseid's."""
    run, loglik = noiseid(samples)
    new = run()
    works: dict[str, Work | str] = {"noiseid": run}

    def put(name: str, work: Work | str, difference: Callable[[Any], tuple[float, str]]) -> None:
        if isinstance(work, str):
            works[name] = work
            return
        known, remark = difference(work())
        works[name + remark] = checked(work, known)

    def of_pykalman(k: Any) -> tuple[float, str]:
        return max(off(k.transition_covariance, new.Q), off(k.observation_covariance, new.R)), ""

    def of_statsmodels(found: Any) -> tuple[float, str]:
        return abs(found.llf_obs.sum() / loglik - 1.0), ", no M-step"

    def of_simdkalman(k: Any) -> tuple[float, str]:
        return off(k.observation_noise, new.R), f", its Q {100.0 * off(k.process_noise, new.Q):.2g} % off"

    put("pykalman", peer(lambda: pykalman(samples)), of_pykalman)
    put("statsmodels", peer(lambda: statsmodels(samples)), of_statsmodels)
    put("simdkalman", peer(lambda: simdkalman(samples)), of_simdkalman)
    return works


def rows() -> list[list[str]]:
    """The comparison for both lengths."""
    out = []
    for samples in SAMPLES:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            out += compared(f"b. linear EM pass, n 5, m 2, N = {samples}", side_by_side(works_of(samples)))
    return out

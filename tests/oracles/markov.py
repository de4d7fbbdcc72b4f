"""Manipulator driven by a Markov process (porter1983_partitioned_recursive, section 5), as matrices with derivatives.

    x1' = x2 ; x2' = lambda + x3 ; x3' = -x3/tau + w, w white with spectral density q ; x3(0) ~ N(0, q tau/2)
    z = x1 + v, v ~ N(0, 0.0025), every second ; (x1, x2)(0) = b ~ N(mu, Sigma)

Parameters alpha = (q, 1/tau). The first measurement comes one interval after x(0), so the first sample has y = NaN.
The control law is chosen in ``simulation.markov_tests`` (the paper prints none); the likelihood does not depend on it.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from noiseid_cli.errors import ModelError
from noiseid_cli.models.parametric import ParametricMatrices, discretise
from noiseid_cli.models.recording import Array, Recording

MEASUREMENT_VARIANCE = 0.0025  # m^2 [paper]
INTERVAL = 1.0  # s [paper]
SAMPLES = 200  # measurements of a test [paper]
TRUE_MEAN = np.array([1.0, 0.5])  # m, m/s [paper]
TRUE_COVARIANCE = np.diag([1.0, 0.25])  # m^2, m^2/s^2 [paper]
TRUE_ALPHA = np.array([0.02, 0.05])  # q m^2/s^5 [chosen: lost in print], 1/tau 1/s [paper]
INITIAL_STATE_MAP = np.eye(3, 2)  # T: b is (x1, x2)(0)
NAMES = ("q", "1/tau")


def markov_matrices(alpha: Array, recording: Recording) -> ParametricMatrices:
    """The matrices of one test; equal intervals are discretised once.

    Args:
        alpha: (2,) spectral density q, m^2/s^5, and 1/tau, 1/s; both positive.
        recording: the test; its intervals are read.

    Raises:
        ModelError: a parameter is not positive.
    """
    if not np.all(alpha > 0.0):
        raise ModelError(f"markov_manipulator: q and 1/tau must be positive, got {alpha[0]:.6g} and {alpha[1]:.6g}")
    q, rate = alpha
    # A test of one sample has no interval; any will do.
    intervals, index = np.unique(recording.dt if len(recording.dt) else [INTERVAL], return_inverse=True)
    steps = [_step(float(q), float(rate), float(dt)) for dt in intervals]
    A, B, Q, dA, dB, dQ = (np.stack([s[i] for s in steps], axis=0 if i < 3 else 1) for i in range(6))
    if len(intervals) > 1:
        A, B, Q, dA, dB, dQ = A[index], B[index], Q[index], dA[:, index], dB[:, index], dQ[:, index]
    S_a, dS_a = np.zeros((3, 3)), np.zeros((2, 3, 3))
    S_a[2, 2] = q / (2.0 * rate)
    dS_a[:, 2, 2] = 1.0 / (2.0 * rate), -q / (2.0 * rate**2)
    C, D, R = np.array([[[1.0, 0.0, 0.0]]]), np.zeros((1, 1, 1)), np.array([[[MEASUREMENT_VARIANCE]]])
    dC, dD, dR = (np.zeros((2, *M.shape)) for M in (C, D, R))
    return ParametricMatrices(A, B, Q, C, D, R, S_a, dA, dB, dQ, dC, dD, dR, dS_a)


@lru_cache(maxsize=1024)
def _step(q: float, rate: float, dt: float) -> tuple[Array, ...]:
    """A, B, Q over one interval and their derivatives in (q, 1/tau); tests of one ensemble share them."""
    F = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -rate]])
    dF = np.zeros((2, 3, 3))
    dF[1, 2, 2] = -1.0
    Qc, dQc = np.diag([0.0, 0.0, q]), np.zeros((2, 3, 3))
    dQc[0, 2, 2] = 1.0
    L = np.array([[0.0], [1.0], [0.0]])
    return discretise(F, L, Qc, dF, np.zeros((2, 3, 1)), dQc, dt)

"""Linear models whose matrices depend on parameters alpha and on time, and their exact discretisation.

x_{k+1} = A_k x_k + B_k u_k + w_k,  w_k ~ N(0, Q_k);  y_k = C_k x_k + D_k u_k + v_k,  v_k ~ N(0, R_k)
x_0 = a + T b,  a ~ N(0, S_a);  T and the law of b stand elsewhere.
"""

# ruff: noqa: N815 - derivatives carry the paper's letters
from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from noiseid_cli.errors import ModelError
from noiseid_cli.models.recording import Array


@dataclass(frozen=True)
class ParametricMatrices:
    """The matrices of one test at one alpha, with their derivatives.

    The first axis of A, B, Q (N-1 intervals) and C, D, R (N samples) is time; a length of 1 means constant. Each
    derivative has the index of the parameter in front: dA is (na, length, nx, nx).

    Attributes:
        A: (., nx, nx) transition; B: (., nx, nu) input gain; Q: (., nx, nx) covariance of w.
        C: (., ny, nx) output map; D: (., ny, nu) feedthrough; R: (., ny, ny) covariance of v.
        S_a: (nx, nx) covariance of a.
        dA, dB, dQ, dC, dD, dR, dS_a: their derivatives in alpha.
    """

    A: Array
    B: Array
    Q: Array
    C: Array
    D: Array
    R: Array
    S_a: Array
    dA: Array
    dB: Array
    dQ: Array
    dC: Array
    dD: Array
    dR: Array
    dS_a: Array

    def __post_init__(self) -> None:
        """Make every array contiguous, and check that all shapes fit each other.

        Raises:
            ModelError: naming the matrix, its shape and the one it should have.
        """
        for field in fields(self):
            object.__setattr__(self, field.name, np.ascontiguousarray(getattr(self, field.name), dtype=float))
        nx, nu, ny, na = self.A.shape[-1], self.B.shape[-1], self.C.shape[-2], len(self.dA)
        expected = {"A": (nx, nx), "B": (nx, nu), "Q": (nx, nx), "C": (ny, nx), "D": (ny, nu), "R": (ny, ny)}
        for name, shape in expected.items():
            M, dM = getattr(self, name), getattr(self, "d" + name)
            if M.ndim != 3 or M.shape[1:] != shape:
                raise ModelError(f"matrix {name} has shape {M.shape}, expected (time, {shape[0]}, {shape[1]})")
            if dM.shape != (na, *M.shape):
                raise ModelError(f"derivative d{name} has shape {dM.shape}, expected {(na, *M.shape)}")
        if self.S_a.shape != (nx, nx) or self.dS_a.shape != (na, nx, nx):
            raise ModelError(
                f"S_a and dS_a have shapes {self.S_a.shape} and {self.dS_a.shape}, expected {(nx, nx)}, {(na, nx, nx)}"
            )


def discretise(
    F: Array, L: Array, Qc: Array, dF: Array, dL: Array, dQc: Array, dt: float
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Exact discretisation of x' = F x + L u + w, u held over the interval, w white, with parameter derivatives.

    A, B from exp([F L; 0 0] dt), Q from Van Loan's exponential (IEEE Trans. Automat. Control 23, 1978, eq. 10);
    derivatives are Frechet derivatives of the same exponentials.

    Args:
        F: (nx, nx); L: (nx, nu); Qc: (nx, nx) spectral density of w, unit of x^2 per s.
        dF, dL, dQc: their derivatives, (na, ...).
        dt: interval, s.

    Returns:
        A (nx, nx), B (nx, nu), Q (nx, nx), dA, dB, dQ with the parameter in front.
    """
    # The exponential holds exp(-F dt), which loses all digits where a mode decays fast: take a short step, double it.
    doublings = max(0, int(np.ceil(np.log2(max(float(np.linalg.norm(F, 1)) * dt, 1.0)))))
    A, B, Q, dA, dB, dQ = _short_step(F, L, Qc, dF, dL, dQc, dt / 2.0**doublings)
    for _ in range(doublings):
        half = dA @ (Q @ A.T)
        dQ = dQ + half + half.transpose(0, 2, 1) + A @ dQ @ A.T
        Q = Q + A @ Q @ A.T
        dB, B = dB + dA @ B + A @ dB, B + A @ B
        dA, A = dA @ A + A @ dA, A @ A
    return A, B, 0.5 * (Q + Q.T), dA, dB, 0.5 * (dQ + dQ.transpose(0, 2, 1))


def _short_step(
    F: Array, L: Array, Qc: Array, dF: Array, dL: Array, dQc: Array, dt: float
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """``discretise`` over an interval in which no mode changes by more than a few times itself."""
    from scipy.linalg import expm, expm_frechet

    nx, nu = L.shape
    na = len(dF)
    motion = np.zeros((nx + nu, nx + nu))
    motion[:nx] = np.hstack((F, L)) * dt
    noise = np.block([[-F, Qc], [np.zeros((nx, nx)), F.T]]) * dt
    E, V = expm(motion), expm(noise)
    A, B = E[:nx, :nx], E[:nx, nx:]
    Q = A @ V[:nx, nx:]
    dA, dB, dQ = np.empty((na, nx, nx)), np.empty((na, nx, nu)), np.empty((na, nx, nx))
    for i in range(na):
        direction = np.zeros_like(motion)
        direction[:nx] = np.hstack((dF[i], dL[i])) * dt
        dE = np.asarray(expm_frechet(motion, direction, compute_expm=False))
        direction = np.block([[-dF[i], dQc[i]], [np.zeros((nx, nx)), dF[i].T]]) * dt
        dV = np.asarray(expm_frechet(noise, direction, compute_expm=False))
        dA[i], dB[i] = dE[:nx, :nx], dE[:nx, nx:]
        dQ[i] = dA[i] @ V[:nx, nx:] + A @ dV[:nx, nx:]
    return A, B, Q, dA, dB, dQ

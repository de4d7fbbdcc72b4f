"""The square-root unscented Kalman filter with additive noise, over a recording or sample by sample.

van der Merwe & Wan (2001); riva2017_sensitivity_asrukf, Tables 1 and 2 without the sensitivities. Order of steps: the
first sample is a correction of the prior; sigma points are redrawn before every correction; the process noise adds
F2 Q F2' with F2 taken at the filtered mean. For a linear model it is the Kalman filter, and so is the extended one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.filters.ekf import OK, FilterDivergedError
from noiseid_cli.filters.linalg import upper_factor
from noiseid_cli.filters.sigma_points import SigmaWeights
from noiseid_cli.filters.srukf_kernel import new_workspace, prepare, run
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording


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
        self._state = s = new_workspace(model, own)
        s.p[:] = model.parameters
        s.weights[:] = weights.eta, weights.outer, weights.cov0
        s.UQ[:] = upper_factor(noise.Q, "the process noise covariance Q")
        s.UR[:] = upper_factor(noise.R, "the measurement noise covariance R")
        s.x[:] = noise.m0[test]
        s.U[:] = upper_factor(noise.P0, "the initial covariance P0")
        if bounds is not None:
            self._state.lower[:], self._state.upper[:] = bounds
        self._handle = prepare(model.scheme, model.drift, model.drift_jacobian, model.output, s)
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
        code, done, loglik = run(self._handle, self.samples == 0, self._dt, self._u, self._y, *self._one)
        self.samples += done
        self.loglik += loglik
        if code != OK:
            raise EstimationError(f"sample {self.samples + 1}: {FilterDivergedError.words(code)}")
        return self._state.x.copy(), self._state.sd.copy()

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
        code, done, loglik = run(self._handle, self.samples == 0, dt, u, y, *out)
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

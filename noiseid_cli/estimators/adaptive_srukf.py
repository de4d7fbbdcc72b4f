"""The sensitivity-based adaptive square-root unscented Kalman filter, sample by sample or over recordings.

riva2017_sensitivity_asrukf, section 2.4. It estimates states, parameters of the model and variances of a diagonal Q at
once: a square-root unscented filter with the derivatives of all that it computes, whose innovations drive a recursive
Gauss-Newton step. ``asrukf`` runs freely; ``sb-asrukf`` holds each parameter while the data do not excite it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.adaptive_kernel import run
from noiseid_cli.estimators.adaptive_workspace import new_workspace, prepare
from noiseid_cli.estimators.unknowns import ParameterUnknowns, Unknowns
from noiseid_cli.filters.ekf import OK, FilterDivergedError
from noiseid_cli.filters.linalg import upper_factor
from noiseid_cli.filters.sigma_points import unscented
from noiseid_cli.filters.srukf import check_sample
from noiseid_cli.models.compile import compile_model
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.equations import Model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array
from noiseid_cli.models.stacked import stack_gains, stack_parameters

DEFAULT_THRESHOLD = 0.05  # chosen


@dataclass(frozen=True)
class AdaptiveOptions:
    """Options of the filter. Unknowns are named by their noise (a variance of Q) or parameter.

    Attributes:
        parameter_covariance: variance Theta of each unknown at the start, in the square of its unit.
        alpha, beta, kappa: spread of the sigma points, see ``filters.sigma_points.unscented``.
        forgetting: lambda of the recursive Gauss-Newton step, in (0, 1].
        monitor: whether each parameter is held while its excitation is below its threshold (``sb-asrukf``).
        window: number of samples over which a sensitivity's maximum is taken; 0: all since the start.
        thresholds: excitation below which a parameter is held; 0.05 for those not named. Variances are never held.
        variance_floor: share of its start below which a variance is not let.
    """

    parameter_covariance: Mapping[str, float]
    alpha: float = 0.85
    beta: float = 2.0
    kappa: float | None = None
    forgetting: float = 0.999
    monitor: bool = True
    window: int = 0
    thresholds: Mapping[str, float] = field(default_factory=dict)
    variance_floor: float = 1e-6


class AdaptiveSample(NamedTuple):
    """What one sample leaves behind.

    Attributes:
        x, x_std: (nx,) filtered mean and standard deviations.
        theta, theta_std: (p,) unknowns and standard deviations, in the order of ``AdaptiveFilter.names``.
        excitation: (p,) normalised sensitivity, summed over the states, between 0 and nx.
        excitation_open_loop: (p,) the same of the model run open-loop (eq. 10); 0 for variances.
        gate: (p,) 1 where the unknown was adapted, 0 where it was held.
    """

    x: Array
    x_std: Array
    theta: Array
    theta_std: Array
    excitation: Array
    excitation_open_loop: Array
    gate: Array


class AdaptiveFilter:
    """The filter as it runs beside a machine: one ``step`` per sample.

    Attributes:
        names: of the unknowns: noises whose variance is estimated, then parameters.
        samples: number of samples taken in since ``restart``.
        loglik: log-likelihood of the innovations of all samples, each under the theta of its time.
    """

    def __init__(
        self,
        model: Model,
        compiled: CompiledModel,
        start: NoiseValues,
        unknowns: Unknowns,
        parameters: ParameterUnknowns,
        options: AdaptiveOptions,
        longest: int | None = None,
    ) -> None:
        """Set up the filter; it starts from row 0 of ``start.m0``.

        Args:
            model: the equations.
            compiled: their compiled form, of which the scheme is taken.
            start: start of Q, and R, m0, P0, which are known.
            unknowns: structure of Q, diagonal, entries may be held; None if Q is known.
            parameters: parameters that are estimated.
            options: see ``AdaptiveOptions``.
            longest: largest number of samples that will be taken in, if known: saves memory of the monitor.

        Raises:
            EstimationError: nothing is unknown, an option does not fit, or a covariance is not usable.
            ModelError: a parameter is not known.
        """
        self.free = free_variances(unknowns)
        self.names = (*(compiled.noises[i] for i in self.free), *parameters.names)
        _check(self.names, parameters, options)
        self._stacked = compile_model(stack_parameters(model, parameters.names))
        self._nx, self._ny, self._nu = compiled.nx, compiled.ny, compiled.nu
        self._start = start
        window = options.window if longest is None else min(options.window, longest)
        gains = stack_gains(model, parameters.names)
        self._gains = self._stacked if gains is None else compile_model(gains)
        self._s = new_workspace(
            self._stacked, None if gains is None else self._gains, compiled.nx, len(self.names), len(self.free), window
        )
        self._fill(parameters, options)
        self._handle = prepare(
            compiled.scheme, self._stacked.drift_jacobian, gains is not None, self._gains.drift_jacobian,
            self._stacked.output_jacobian, options.window, self._s,
        )  # fmt: skip
        n, p = self._nx, len(self.names)
        ends = [0, n, 2 * n, *(2 * n + k * p for k in range(1, 6))]
        self._columns = [slice(a, b) for a, b in pairwise(ends)]  # of each array of ``AdaptiveSample``
        self._one = np.zeros((1, ends[-1]))
        self._y, self._u, self._dt = np.zeros((1, self._ny)), np.zeros((1, self._nu)), np.zeros(1)
        self.loglik = 0.0
        self.restart()

    def _fill(self, parameters: ParameterUnknowns, options: AdaptiveOptions) -> None:
        """Write what the options say, and the start of what is estimated, into the workspace."""
        s, start = self._s, self._start
        w = unscented(self._nx, options.alpha, options.beta, options.kappa)
        s.p[:] = self._stacked.parameters
        s.weights[:] = w.eta, w.outer, w.cov0, options.forgetting
        s.free[:] = self.free
        variances = np.diag(start.Q)[s.free]
        s.theta[:] = np.concatenate((variances, parameters.start))
        s.lower[:] = np.concatenate((options.variance_floor * variances, parameters.lower))
        s.upper[:] = np.concatenate((np.full(len(variances), np.inf), parameters.upper))
        thresholds = dict.fromkeys(self.names, DEFAULT_THRESHOLD) | dict(options.thresholds)
        s.thresholds[:] = [thresholds[n] if options.monitor else -1.0 for n in self.names]
        s.UR[:] = upper_factor(start.R, "the measurement noise covariance R")
        s.UQ[:] = upper_factor(start.Q, "the process noise covariance Q")
        s.UT[:] = np.diag(np.sqrt([options.parameter_covariance[name] for name in self.names]))
        s.UD[:] = s.UR

    def restart(self, test: int = 0) -> None:
        """Begin a new test: the state is that of the prior; theta, Theta, Delta and the monitor go on.

        Args:
            test: row of ``start.m0`` that is the mean of the first state.
        """
        s = self._s
        s.x[:] = self._start.m0[test]
        s.U[:] = upper_factor(self._start.P0, "the initial covariance P0")
        for kept in (s.dx, s.dU, s.dP, s.open_loop):
            kept[...] = 0.0
        self.samples = 0

    @property
    def theta(self) -> Array:
        """(p,) unknowns after the last sample."""
        return self._s.theta.copy()

    @property
    def theta_std(self) -> Array:
        """(p,) their standard deviations, from Theta."""
        return np.asarray(np.sqrt(np.sum(self._s.UT**2, axis=0)))

    @property
    def restacked(self) -> int:
        """Number of corrections whose downdate failed and was replaced, see ``filters.sigma_steps.condition``."""
        return int(self._s.counts[1])

    @property
    def projections(self) -> dict[str, int]:
        """How often each unknown was put back on a bound."""
        return dict(zip(self.names, map(int, self._s.counts[2:]), strict=True))

    def step(self, y: Array, u: Array, dt: float = 0.0) -> AdaptiveSample:
        """Take in one sample.

        Args:
            y: (ny,) outputs; NaN where missing.
            u: (nu,) inputs, held until the next sample.
            dt: interval since the previous sample, s; not read at the first one.

        Raises:
            EstimationError: the filter failed; in words.
        """
        check_sample(y, u, self._ny, self._nu)
        self._y[0], self._u[0], self._dt[0] = y, u, dt
        code, done, loglik = run(self._handle, self.samples == 0, self._dt, self._u, self._y, 1, self._one)
        self.samples += done
        self.loglik += loglik
        if code != OK:
            raise EstimationError(f"sample {self.samples + 1}: {FilterDivergedError.words(code)}")
        row = self._one[0].copy()
        return AdaptiveSample(*[row[columns] for columns in self._columns])

    def take(self, y: Array, u: Array, dt: Array, stride: int) -> tuple[int, int, tuple[Array, ...]]:
        """Take in a block of samples.

        Args:
            y: (N, ny); u: (N, nu); dt: (N,) interval before each sample.
            stride: which samples are returned: 0, stride, 2 stride, ...

        Returns:
            A code of ``filters.ekf``, the number of samples taken in, and the arrays of ``AdaptiveSample`` with one
            row per returned sample; NaN in rows that a failure did not reach.
        """
        rows = np.full((-(-len(y) // stride), self._one.shape[1]), np.nan)
        code, done, loglik = run(self._handle, self.samples == 0, dt, u, y, stride, rows)
        self.samples += done
        self.loglik += loglik
        return code, done, tuple(rows[:, columns] for columns in self._columns)


def free_variances(unknowns: Unknowns) -> tuple[int, ...]:
    """Indices of the variances of Q that are estimated.

    Raises:
        EstimationError: Q is not diagonal.
    """
    if unknowns.Q is None:
        return ()
    if unknowns.Q.scale or any(len(block) > 1 for block in unknowns.Q.blocks):
        raise EstimationError(
            "the adaptive filters estimate variances of a diagonal process noise: give it `structure: diagonal`"
        )
    return tuple(i for i, j in unknowns.Q.free if i == j)


def named(values: Mapping[str, float], names: tuple[str, ...], what: str, least: float) -> None:
    """Refuse a table that names a stranger, or holds a number below ``least``.

    Raises:
        EstimationError: with the name and those that are allowed.
    """
    for name, value in values.items():
        if name not in names:
            raise EstimationError(f"{what} names {name}, which is not estimated; the unknowns are {', '.join(names)}")
        if not (value >= least and np.isfinite(value)):
            raise EstimationError(f"{what} of {name} is {value:g}; it must be a finite number of at least {least:g}")


def complete(values: Mapping[str, float], names: tuple[str, ...], what: str) -> None:
    """Refuse a table in which an unknown is missing.

    Raises:
        EstimationError: with the names that are missing.
    """
    named(values, names, what, 0.0)
    missing = [name for name in names if name not in values]
    if missing:
        raise EstimationError(f"{what} has no entry for {', '.join(missing)}: give each unknown a variance")


def _check(names: tuple[str, ...], parameters: ParameterUnknowns, options: AdaptiveOptions) -> None:
    if not names:
        raise EstimationError("nothing is unknown: name parameters, or give process_noise a start")
    complete(options.parameter_covariance, names, "parameter_covariance")
    if not 0.0 < options.forgetting <= 1.0:
        raise EstimationError(f"forgetting is {options.forgetting:g}; it must be above 0 and at most 1")
    if options.window < 0:
        raise EstimationError(f"window is {options.window}; it must be a number of samples, or 0 for all")
    named(options.thresholds, parameters.names, "thresholds", 0.0)

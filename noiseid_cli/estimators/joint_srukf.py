"""The joint square-root unscented filter: parameters as states that stay constant but for a small noise.

riva2017_sensitivity_asrukf, eq. 4; Wan & van der Merwe (2000). The stacked model runs through the same filter as any
other: no sensitivities, no forgetting.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.adaptive_srukf import complete
from noiseid_cli.estimators.data_check import check_data
from noiseid_cli.estimators.estimate import Estimate, Parameters, Progress, Series
from noiseid_cli.estimators.online_record import (
    TimeAxis,
    frozen_loglik,
    online_safeguards,
    online_settings,
    parameter_columns,
    ran_through,
    state_columns,
    with_parameters,
)
from noiseid_cli.estimators.unknowns import ParameterUnknowns
from noiseid_cli.filters.ekf import OK, FilterDivergedError
from noiseid_cli.filters.sigma_points import unscented
from noiseid_cli.filters.srukf import SquareRootUnscentedFilter
from noiseid_cli.models.compile import compile_model
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.equations import Model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording
from noiseid_cli.models.stacked import stack_parameters

BLOCK = 4096
"""About so many samples are filtered before those that are not kept are let go."""


@dataclass(frozen=True)
class JointOptions:
    """Options of the filter; parameters are named.

    Attributes:
        parameter_covariance: variance of each parameter at the start, in the square of its unit.
        parameter_noise: variance that each sample adds to it.
        alpha, beta, kappa: spread of the sigma points, see ``filters.sigma_points.unscented``; n counts the
            parameters too.
    """

    parameter_covariance: Mapping[str, float]
    parameter_noise: Mapping[str, float]
    alpha: float = 0.85
    beta: float = 2.0
    kappa: float | None = None


class JointFilter:
    """The filter as it runs beside a machine: one ``step`` per sample, states and parameters in one vector.

    Attributes:
        names: of the parameters.
        online: the square-root unscented filter of the stacked model.
    """

    def __init__(
        self,
        model: Model,
        compiled: CompiledModel,
        noise: NoiseValues,
        parameters: ParameterUnknowns,
        options: JointOptions,
    ) -> None:
        """Start from row 0 of ``noise.m0``.

        Args:
            model, compiled: the equations and their compiled form, of which the scheme is taken.
            noise: Q, R, m0, P0, all known.
            parameters: those that are estimated, with their start and bounds.
            options: see ``JointOptions``.

        Raises:
            EstimationError: no parameter is unknown, or an option does not fit.
            ModelError: a parameter is not known.
        """
        self.names = parameters.names
        if not self.names:
            raise EstimationError("joint-srukf estimates parameters of the model: name them under estimate.parameters")
        complete(options.parameter_covariance, self.names, "parameter_covariance")
        complete(options.parameter_noise, self.names, "parameter_noise")
        self._n = compiled.nx
        self._noise = noise
        self._stacked = replace(compile_model(stack_parameters(model, self.names)), scheme=compiled.scheme)
        self._weights = unscented(self._stacked.nx, options.alpha, options.beta, options.kappa)
        self._added = np.diag([0.0] * self._n + [options.parameter_noise[name] for name in self.names])
        free = np.full(self._n, np.inf)
        self._bounds = (np.concatenate((-free, parameters.lower)), np.concatenate((free, parameters.upper)))
        self._past: list[SquareRootUnscentedFilter] = []
        P = np.diag([options.parameter_covariance[name] for name in self.names])
        self.online = self._begin(0, parameters.start, P)

    def _begin(self, test: int, theta: Array, P: Array) -> SquareRootUnscentedFilter:
        n, total = self._n, self._stacked.nx
        P0 = np.zeros((total, total))
        P0[:n, :n], P0[n:, n:] = self._noise.P0, P
        m0 = np.concatenate((self._noise.m0[test], theta))[None]
        noise = NoiseValues(self._noise.Q, self._noise.R, m0, P0)
        return SquareRootUnscentedFilter(self._stacked, noise, self._weights, self._added, bounds=self._bounds)

    def restart(self, test: int = 0) -> None:
        """Begin a new test: the state is that of the prior; the parameters and their covariance go on.

        Args:
            test: row of ``m0`` that is the mean of the first state.
        """
        if self.online.samples:
            self._past.append(self.online)
            U = self.online.factor[:, self._n :]
            self.online = self._begin(test, self.theta, U.T @ U)

    @property
    def loglik(self) -> float:
        """Log-likelihood of the innovations of all tests."""
        return sum(f.loglik for f in (*self._past, self.online))

    @property
    def restacked(self) -> int:
        """Number of corrections whose downdate failed and was replaced."""
        return sum(f.restacked for f in (*self._past, self.online))

    @property
    def projections(self) -> dict[str, int]:
        """How often each parameter was put back on a bound."""
        counts = np.sum([f.projections[self._n :] for f in (*self._past, self.online)], axis=0)
        return dict(zip(self.names, counts.tolist(), strict=True))

    @property
    def theta(self) -> Array:
        """(p,) parameters after the last sample."""
        return self.online.mean[self._n :]

    @property
    def theta_std(self) -> Array:
        """(p,) their standard deviations."""
        return np.asarray(np.sqrt(np.sum(self.online.factor**2, axis=0))[self._n :])

    def step(self, y: Array, u: Array, dt: float = 0.0) -> tuple[Array, Array]:
        """Take in one sample; see ``SquareRootUnscentedFilter.step``, with the parameters after the states."""
        return self.online.step(y, u, dt)


def estimate(
    model: Model,
    compiled: CompiledModel,
    recordings: Sequence[Recording],
    noise: NoiseValues,
    parameters: ParameterUnknowns,
    options: JointOptions,
    progress: Progress | None = None,
) -> Estimate:
    """Run the filter once through the recordings, one after the other; the parameters go on.

    Args:
        model, compiled, noise, parameters, options: see ``JointFilter``.
        recordings: the tests, in the order in which they are filtered.
        progress: called at the end with the log-likelihood of the innovations.

    Returns:
        The estimate: the parameters after the last sample. ``loglik_start`` and ``loglik`` are those of the plain
        filter with the parameters held at the start and at the end; NaN where it fails. Series: parameters,
        parameters_std, parameters_true, states, states_std, states_true.

    Raises:
        EstimationError: see ``JointFilter`` and ``check_data``.
        ModelError: a parameter is not known.
    """
    check_data(compiled, recordings, steps_needed=False)
    began = time.perf_counter()
    filter_ = JointFilter(model, compiled, noise, parameters, options)
    axis = TimeAxis.of(recordings)
    mean, std, failure = _run(filter_, axis)
    n = compiled.nx
    theta = filter_.theta
    if failure:
        theta = mean[-1, n:] if len(mean) else parameters.start
    weights = unscented(n, options.alpha, options.beta)
    logliks = [
        frozen_loglik(with_parameters(compiled, model, parameters.names, values), recordings, noise, weights)
        for values in (parameters.start, theta)
    ]
    if progress is not None:
        progress(1, filter_.loglik)
    return Estimate(
        method="joint-srukf",
        status="diverged" if failure else "converged",
        reason=failure or ran_through(axis, filter_.loglik),
        start=noise,
        final=noise,
        loglik_start=logliks[0],
        loglik=logliks[1],
        passes=1,
        seconds=time.perf_counter() - began,
        safeguards=online_safeguards(filter_.projections, filter_.restacked),
        settings=online_settings(options),
        parameters=Parameters(
            parameter_columns(model, parameters.names), parameters.start, theta, None if failure else filter_.theta_std
        ),
        series=_series(model, filter_.names, axis, mean, std),
    )


def _run(filter_: JointFilter, axis: TimeAxis) -> tuple[Array, Array, str]:
    """Kept rows of the stacked means and standard deviations, and why the filter failed, empty if it did not."""
    means, stds = [], []
    block = axis.stride * max(1, BLOCK // axis.stride)
    for i, r in enumerate(axis.recordings):
        filter_.restart(i)
        y, u = np.ascontiguousarray(r.y), np.ascontiguousarray(r.u)
        dt = np.concatenate(([0.0], r.dt))
        for begin in range(0, r.samples, block):
            part = slice(begin, begin + block)
            code, k, found = filter_.online.take(y[part], u[part], dt[part])
            means.append(found.m_filt[: k : axis.stride])
            stds.append(np.sqrt(np.sum(found.U_filt[: k : axis.stride] ** 2, axis=1)))
            if code != OK:
                return np.concatenate(means), np.concatenate(stds), str(FilterDivergedError(code, begin + k, r))
    return np.concatenate(means), np.concatenate(stds), ""


def _series(model: Model, names: tuple[str, ...], axis: TimeAxis, mean: Array, std: Array) -> tuple[Series, ...]:
    unknowns, states = parameter_columns(model, names), state_columns(model)
    n = len(states)
    return (
        axis.series("parameters", unknowns, mean[:, n:]),
        axis.series("parameters_std", unknowns, std[:, n:]),
        axis.series("states", states, mean[:, :n]),
        axis.series("states_std", states, std[:, :n]),
        *axis.parameters_true(model, names, len(mean)),
        *axis.states_true(states, len(mean)),
    )

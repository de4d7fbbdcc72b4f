"""The adaptive filter over recordings, as an estimate: methods ``asrukf`` and ``sb-asrukf``."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from noiseid_cli.estimators.adaptive_srukf import AdaptiveFilter, AdaptiveOptions
from noiseid_cli.estimators.data_check import check_data
from noiseid_cli.estimators.estimate import Estimate, Parameters, Progress, Series, Status
from noiseid_cli.estimators.online_record import (
    TimeAxis,
    frozen_loglik,
    online_safeguards,
    online_settings,
    parameter_columns,
    ran_through,
    state_columns,
    variance_columns,
    with_parameters,
)
from noiseid_cli.estimators.unknowns import ParameterUnknowns, Unknowns
from noiseid_cli.filters.ekf import OK, FilterDivergedError
from noiseid_cli.filters.sigma_points import unscented
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.equations import Model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording


@dataclass(frozen=True)
class _Run:
    """What the filter left behind: rows of the series, in the order of ``AdaptiveSample``, and how it ended."""

    rows: tuple[Array, ...]
    failure: str


def estimate(
    model: Model,
    compiled: CompiledModel,
    recordings: Sequence[Recording],
    start: NoiseValues,
    unknowns: Unknowns,
    parameters: ParameterUnknowns,
    options: AdaptiveOptions,
    progress: Progress | None = None,
) -> Estimate:
    """Run the filter once through the recordings, one after the other; theta and its covariance go on.

    Args:
        model, compiled: the equations and their compiled form.
        recordings: the tests, in the order in which they are filtered.
        start: start of Q; R, m0 and P0, which are known.
        unknowns, parameters: see ``AdaptiveFilter``.
        options: see ``AdaptiveOptions``; ``monitor`` makes the difference between ``asrukf`` and ``sb-asrukf``.
        progress: called at the end with the log-likelihood of the innovations.

    Returns:
        The estimate: the unknowns after the last sample, with standard errors from Theta. ``loglik_start`` and
        ``loglik`` are those of the same filter with the unknowns held at the start and at the end; where it fails,
        NaN. Series: parameters, parameters_std, parameters_true, sensitivity, sensitivity_open_loop, open, states,
        states_std, states_true.

    Raises:
        EstimationError: see ``AdaptiveFilter`` and ``check_data``.
        ModelError: a parameter is not known.
    """
    check_data(compiled, recordings, steps_needed=unknowns.Q is not None)
    began = time.perf_counter()
    filter_ = AdaptiveFilter(
        model, compiled, start, unknowns, parameters, options, longest=sum(r.samples for r in recordings)
    )
    axis = TimeAxis.of(recordings)
    begin = filter_.theta
    done = _run(filter_, axis)
    # After a failure theta itself may be lost: the last row that was kept stands for it.
    theta = np.vstack((begin, done.rows[2]))[-1] if done.failure else filter_.theta
    nq = len(filter_.free)
    Q = start.Q.copy()
    Q[list(filter_.free), list(filter_.free)] = theta[:nq]
    final = NoiseValues(Q, start.R, start.m0, start.P0)
    weights = unscented(compiled.nx, options.alpha, options.beta, options.kappa)
    logliks = [
        frozen_loglik(with_parameters(compiled, model, parameters.names, values), recordings, noise, weights)
        for values, noise in ((parameters.start, start), (theta[nq:], final))
    ]
    if progress is not None:
        progress(1, filter_.loglik)
    status: Status = "diverged" if done.failure else "converged"
    return Estimate(
        method="sb-asrukf" if options.monitor else "asrukf",
        status=status,
        reason=done.failure or _reason(filter_, axis, done.rows[6]),
        start=start,
        final=final,
        loglik_start=logliks[0],
        loglik=logliks[1],
        passes=1,
        seconds=time.perf_counter() - began,
        safeguards=online_safeguards(filter_.projections, filter_.restacked),
        settings=online_settings(options),
        parameters=_parameters(model, parameters, theta[nq:], done, filter_),
        series=_series(model, filter_, axis, done.rows),
    )


def _run(filter_: AdaptiveFilter, axis: TimeAxis) -> _Run:
    parts: list[tuple[Array, ...]] = []
    failure = ""
    for i, r in enumerate(axis.recordings):
        filter_.restart(i)
        dt = np.concatenate(([0.0], r.dt))
        code, k, rows = filter_.take(np.ascontiguousarray(r.y), np.ascontiguousarray(r.u), dt, axis.stride)
        parts.append(tuple(row[: -(-k // axis.stride)] for row in rows))
        if code != OK:
            failure = str(FilterDivergedError(code, k, r))
            break
    return _Run(tuple(np.concatenate(part) for part in zip(*parts, strict=True)), failure)


def _reason(filter_: AdaptiveFilter, axis: TimeAxis, gate: Array) -> str:
    text = ran_through(axis, filter_.loglik)
    held = [(n, s) for n, s in zip(filter_.names, 1.0 - gate.mean(axis=0), strict=True) if s >= 0.005]
    return text + (f"; held: {', '.join(f'{n} {100 * s:.0f} %' for n, s in held)} of the time" if held else "")


def _parameters(
    model: Model, parameters: ParameterUnknowns, final: Array, done: _Run, filter_: AdaptiveFilter
) -> Parameters | None:
    if not len(parameters):
        return None
    errors = None if done.failure else filter_.theta_std[len(filter_.free) :]
    return Parameters(parameter_columns(model, parameters.names), parameters.start, final, errors)


def _series(model: Model, filter_: AdaptiveFilter, axis: TimeAxis, rows: tuple[Array, ...]) -> tuple[Series, ...]:
    names = filter_.names[len(filter_.free) :]
    unknowns = (*variance_columns(model, filter_.free), *parameter_columns(model, names))
    plain = tuple((name, "1", description) for name, _, description in unknowns)
    states = state_columns(model)
    columns = {
        "states": states, "states_std": states, "parameters": unknowns, "parameters_std": unknowns,
        "sensitivity": plain, "sensitivity_open_loop": plain, "open": plain,
    }  # fmt: skip
    count = len(rows[0])
    return (
        *(axis.series(name, own, values) for (name, own), values in zip(columns.items(), rows, strict=True)),
        *axis.parameters_true(model, names, count),
        *axis.states_true(states, count),
    )

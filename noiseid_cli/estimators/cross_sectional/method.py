"""`batch-ml` and `recursive-ml`: from an ensemble to an estimate."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.cross_sectional.batch import BatchEstimate, BatchOptions, batch_ml
from noiseid_cli.estimators.cross_sectional.ensemble import Ensemble, observed
from noiseid_cli.estimators.cross_sectional.problem import Theta
from noiseid_cli.estimators.cross_sectional.recursive import continue_recursion, start_recursion
from noiseid_cli.estimators.cross_sectional.recursive_state import RecursiveOptions, RecursiveState
from noiseid_cli.estimators.estimate import Estimate, Parameters, Progress, Series, Status
from noiseid_cli.models.recording import Array

MAX_LINEARISATIONS = 50
STILL = 1e-4
"""A nonlinear model is linearised anew until theta moves by less than this share of its standard errors."""


def batch(
    ensemble: Ensemble,
    options: BatchOptions | None = None,
    progress: Progress | None = None,
    at_tests: Sequence[int] = (),
) -> Estimate:
    """Estimate theta from all tests at once.

    Args:
        ensemble: tests, model and unknowns.
        options: see ``BatchOptions``.
        progress: told of each evaluation of all tests.
        at_tests: numbers of first tests at which an estimate of their own is wanted, for comparison with a recursion.

    Raises:
        EstimationError: see ``batch_ml``; or ``at_tests`` asks for more tests than there are.
    """
    options, began = options or BatchOptions(), time.perf_counter()
    beyond = [n for n in at_tests if not 1 < n <= len(ensemble)]
    if beyond:
        raise EstimationError(
            f"at_tests must be between 2 and the {len(ensemble)} tests that there are, not {beyond[0]}"
        )
    trace = _Trace(ensemble, progress)
    found = _batch(ensemble, ensemble.start, options, trace)
    partial = []
    for n in sorted(set(at_tests) - {len(ensemble)}):
        partial.append((n, _batch(ensemble.select(n), ensemble.start, options, _Trace(ensemble, None))))
    partial.append((len(ensemble), found))
    counts = np.array([n for n, _ in partial], dtype=float)
    values = np.array([_natural(ensemble, b.theta) for _, b in partial])
    errors = np.array([b.standard_errors for _, b in partial])
    scored = found.scored
    safeguards = []
    if scored.halvings:
        safeguards.append(f"a step was halved {scored.halvings} times")
    if scored.held:
        safeguards.append(
            f"{scored.held} direction(s) of the covariance of the first state are held at zero, where the likelihood "
            "is largest; their standard errors are those of a free direction"
        )
    status: Status = "converged" if found.converged else "max_passes"
    return Estimate(
        method="batch-ml",
        status=status,
        reason=scored.reason,
        start=ensemble.noise(ensemble.start),
        final=ensemble.noise(found.theta),
        loglik_start=trace.loglik[0],
        loglik=trace.constant - scored.nll,
        passes=len(trace.loglik),
        seconds=time.perf_counter() - began,
        trace={"loglik": np.array(trace.loglik)},
        safeguards=tuple(safeguards),
        settings=_settings(ensemble, asdict(options)),
        parameters=_parameters(ensemble, ensemble.start, found.theta, found.standard_errors),
        series=_over_tests(ensemble, counts, values, errors),
    )


def recursive(
    ensemble: Ensemble,
    options: RecursiveOptions | None = None,
    progress: Progress | None = None,
    state: RecursiveState | None = None,
) -> Estimate:
    """Estimate theta test by test; the estimate's ``state`` takes in further tests later.

    Args:
        ensemble: tests, in the order of use, model and unknowns.
        options: see ``RecursiveOptions``; with a ``state`` they must be its own, or not be given.
        progress: told of each test.
        state: of an earlier run, whose tests are not needed any more.

    Raises:
        EstimationError: see ``start_recursion`` and ``continue_recursion``.
    """
    began, done = time.perf_counter(), 0
    start = ensemble.start if state is None else state.theta
    if state is not None and options not in (None, state.options):
        raise EstimationError(f"the state was made with {state.options}; it cannot go on with {options}")
    if state is None:
        options = options or RecursiveOptions()
        done = min(options.first, len(ensemble))
        theta = start
        if ensemble.compiled is not None:
            theta = _batch(ensemble.select(done), start, BatchOptions(), _Trace(ensemble, None)).theta
        state = start_recursion(ensemble.tests(theta, slice(done)), theta, ensemble.coordinates, options)
    elif state.coordinates != ensemble.coordinates:
        raise EstimationError("the state is of other unknowns than those of this experiment")
    for i in range(done, len(ensemble)):
        # A nonlinear model is linearised about the test's own path at the estimate so far.
        state = continue_recursion(state, ensemble.tests(state.theta, slice(i, i + 1)))
        if progress is not None:
            progress(state.count, float("nan"))
    counts = np.arange(state.count - len(state.history) + 1, state.count + 1, dtype=float)
    values = np.array([_natural(ensemble, ensemble.coordinates.unpack(v)) for v in state.history])
    return Estimate(
        method="recursive-ml",
        status="converged",
        reason=f"each of {state.count} tests was taken in once",
        start=ensemble.noise(start),
        final=ensemble.noise(state.theta),
        loglik_start=float("nan"),
        loglik=float("nan"),
        passes=state.count,
        seconds=time.perf_counter() - began,
        safeguards=state.safeguards,
        settings=_settings(ensemble, asdict(state.options)),
        parameters=_parameters(ensemble, start, state.theta, state.standard_errors),
        series=_over_tests(ensemble, counts, values, state.history_errors),
        state=state.arrays(),
    )


class _Trace:
    """Log-likelihood of each evaluation, with the term that the paper's l leaves out."""

    def __init__(self, ensemble: Ensemble, progress: Progress | None) -> None:
        self.constant = -0.5 * np.log(2.0 * np.pi) * observed(ensemble.recordings)
        self.loglik: list[float] = []
        self._progress = progress

    def __call__(self, number: int, value: float) -> None:
        self.loglik.append(self.constant + value)
        if self._progress is not None:
            self._progress(len(self.loglik), self.loglik[-1])


def _batch(ensemble: Ensemble, start: Theta, options: BatchOptions, trace: _Trace) -> BatchEstimate:
    """Maximise; the paths of a nonlinear model and the estimate follow each other until neither moves."""
    found = batch_ml(ensemble.tests(start), start, ensemble.coordinates, options, trace)
    if ensemble.compiled is None:
        return found
    for _ in range(MAX_LINEARISATIONS):
        before = ensemble.coordinates.pack(found.theta)
        found = batch_ml(ensemble.tests(found.theta), found.theta, ensemble.coordinates, options, trace)
        moved = np.abs(ensemble.coordinates.pack(found.theta) - before)
        slopes = ensemble.coordinates.slopes(found.theta)
        if np.all(moved * slopes <= STILL * found.standard_errors):
            return found
    raise EstimationError(
        f"linearising the model anew about its smoothed paths does not settle in {MAX_LINEARISATIONS} rounds: start "
        "nearer to the truth, or give shorter tests"
    )


def _natural(ensemble: Ensemble, theta: Theta) -> Array:
    """Theta as one vector in its own units, in the order of ``Ensemble.names``."""
    c = ensemble.coordinates
    return np.concatenate((theta.mu, theta.Sigma[c.rows, c.columns], theta.alpha))


def _parameters(ensemble: Ensemble, start: Theta, end: Theta, errors: Array) -> Parameters:
    return Parameters(
        ensemble.names, _natural(ensemble, start), _natural(ensemble, end), errors, log_scale=ensemble.log_scale
    )


def _over_tests(ensemble: Ensemble, counts: Array, values: Array, errors: Array) -> tuple[Series, ...]:
    axis, names = ("tests", ""), ensemble.names
    curves = (
        Series("over_tests", "Estimate over the number of tests", axis, counts, names, values),
        Series("over_tests_errors", "Standard errors over the number of tests", axis, counts, names, errors),
    )
    sampled = _sampled_truth(ensemble)
    return curves if sampled is None else (*curves, sampled)


def _sampled_truth(ensemble: Ensemble) -> Series | None:
    """Sample mean and covariance of the first states that the first tests had; None where they are not known."""
    first, c = ensemble.first, ensemble.coordinates
    if len(ensemble) < 2 or any(r.x_true is None for r in ensemble.recordings):
        return None
    pairs = zip(first.maps, ensemble.recordings, strict=True)
    b = np.array([np.linalg.lstsq(T, r.x_true[0])[0] for T, r in pairs if r.x_true is not None])
    counts = np.arange(2, len(b) + 1)
    spreads = [np.atleast_2d(np.cov(b[:n], rowvar=False))[c.rows, c.columns] for n in counts]
    values = np.hstack(([b[:n].mean(axis=0) for n in counts], spreads))
    names = ensemble.names[: c.n_beta]
    title = "Sample moments of the true first states over the number of tests"
    return Series("sampled_truth", title, ("tests", ""), counts.astype(float), names, values)


def _settings(ensemble: Ensemble, options: dict[str, Any]) -> dict[str, Any]:
    kind = "linear" if ensemble.compiled is None else "linearised about smoothed paths"
    return {"model": kind, "covariance of the first state": ensemble.coordinates.structure, **options}

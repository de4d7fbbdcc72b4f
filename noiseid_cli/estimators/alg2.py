"""Minimisation of the path error of the extended Kalman filter (axelsson2011_poster, Alg. 2).

Q = diag(lambda) Q0 with Q0 diagonal; sqrt(sum_k |e_k|^2), e_k the error of the filter's performance output, is
minimised over log lambda. The truth behind the recordings has to be known. The objective is a sum of squares, and
``least_squares`` knows it: Gauss-Newton steps in a box, on the errors themselves. ``nelder_mead`` needs values only.

Measured (flexible robot, 4000 samples, 2 realisations x 6 starts, factors 1e-3..1e3 on each variance): every optimiser
ended at one path error, to 1e-6, in so many runs of the filter: least_squares 92, COBYQA 121, Powell 291, L-BFGS-B 332,
nelder_mead 380, BFGS 474. From factors 1e-6..1e6 least_squares did so 12 times of 12 in 113 runs, nelder_mead 11 times.
Over lambda itself the same optimisers' ends depend on the start, as the poster reports; over log lambda they do not.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.data_check import check_data
from noiseid_cli.estimators.estimate import Estimate, Progress, Status
from noiseid_cli.estimators.path_search import LostError, PathSearch, SpentError
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording

EPS = float(np.finfo(float).eps)
# Edge of the first simplex in log lambda.
SIMPLEX = 1.0
# An end within this share of the range of log lambda, from its edge, lies on the edge.
EDGE = 1e-2


@dataclass(frozen=True)
class Alg2Options:
    """Options of ``estimate``.

    Attributes:
        optimiser: ``least_squares`` or ``nelder_mead``.
        max_passes: give up after so many runs of the filter over the data.
        parameter_tolerance: stop when log lambda rests: the optimiser's xtol (``least_squares``: relative to the length
            of log lambda) or xatol (``nelder_mead``: size of the simplex).
        objective_tolerance: stop when the objective rests: ftol, relative, on the sum of squares (``least_squares``),
            or fatol, relative to the start's path error (``nelder_mead``, which needs both to rest).
        lambda_span: each lambda is searched between 1 / lambda_span and lambda_span.
    """

    optimiser: Literal["least_squares", "nelder_mead"] = "least_squares"
    max_passes: int = 1000
    parameter_tolerance: float = 1e-5
    objective_tolerance: float = 1e-9
    lambda_span: float = 1e8


def estimate(
    model: CompiledModel,
    recordings: Sequence[Recording],
    start: NoiseValues,
    options: Alg2Options | None = None,
    progress: Progress | None = None,
) -> Estimate:
    """Identify a diagonal process noise covariance by minimising the path error.

    Args:
        model: the compiled model, with a performance output.
        recordings: the tests, with true performance outputs; samples where one is NaN do not count.
        start: noise values to start from, Q (Q0 of the paper) diagonal; all but Q stay as they are.
        options: see ``Alg2Options``.
        progress: called after each run of the filter that did not fail.

    Returns:
        The estimate; its ``final`` is the visited point of smallest path error, its ``passes`` are runs of the filter.
        Its trace has one entry per run, and ``objective`` (runs,) besides: the path error in the performance output's
        unit, infinite where the filter failed; ``change`` is the largest step of a log standard deviation from the
        best point so far, ``accepted`` is 1 where the point became the best.

    Raises:
        EstimationError: no performance output, no truth, or a start that is not diagonal.
        FilterDivergedError: the filter fails at the start itself.
    """
    options = options or Alg2Options()
    _check(model, recordings, start, options)
    began = time.perf_counter()
    search = PathSearch(model, recordings, start, options.max_passes, float(np.log(options.lambda_span)), progress)
    drive = {"least_squares": _least_squares, "nelder_mead": _nelder_mead}[options.optimiser]
    try:
        status, why = drive(search, options)
    except SpentError:
        status, why = "max_passes", "these were not enough for the optimiser to come to rest"
    except LostError:
        status, why = "numerical", "the filter fails on both sides of the best point, so that no slope can be had"
    unit = model.units.get(model.performances[0], "")
    ends = (f"{value:.6g} {unit}".strip() for value in (search.objectives[0], search.objectives[search.best]))
    return Estimate(
        method="alg2",
        status=status,
        reason=f"after {len(search.path)} runs of the filter the path error came from {' to '.join(ends)}: {why}",
        start=start,
        final=search.noise(search.path[search.best]),
        loglik_start=search.logliks[0],
        loglik=search.logliks[search.best],
        passes=len(search.path),
        seconds=time.perf_counter() - began,
        trace=_trace(search),
        safeguards=tuple(_safeguards(search)),
        settings=asdict(options),
    )


def _check(model: CompiledModel, recordings: Sequence[Recording], start: NoiseValues, options: Alg2Options) -> None:
    """Refuse what the method has no answer for."""
    check_data(model, recordings)
    if model.performance is None:
        raise EstimationError(
            f"alg2 minimises the error of a performance output, such as a tool position, and model {model.name!r} has "
            "none; em and alg3 do without"
        )
    for recording in recordings:
        if recording.z_true is None or np.isnan(recording.z_true).any(axis=1).all():
            raise EstimationError(
                f"test {recording.name!r} has no true {', '.join(model.performances)}: alg2 compares the filter with "
                "it; em and alg3 do without"
            )
    Q0 = start.Q
    if np.any(np.diag(np.diag(Q0)) != Q0) or not np.all(np.diag(Q0) > 0.0):
        raise EstimationError(
            "alg2 scales the variances of a diagonal start: give process_noise a start with positive variances and no "
            "covariances, or use em, which estimates a full covariance"
        )
    if not options.lambda_span > 1.0:
        raise EstimationError(f"lambda_span is {options.lambda_span:g}; it must be above 1")
    tolerances = (options.parameter_tolerance, options.objective_tolerance)
    if options.optimiser == "least_squares" and max(tolerances) < EPS:
        raise EstimationError(
            f"parameter_tolerance and objective_tolerance are both below {EPS:.2g}: least_squares would never stop; "
            "give one of them"
        )


def _least_squares(search: PathSearch, o: Alg2Options) -> tuple[Status, str]:
    """Gauss-Newton steps with a dog-leg in a box (scipy's dogbox); errors count in units of the start's path error."""
    from scipy.optimize import least_squares

    # The optimiser asks for the slope where it has just accepted a value.
    last = np.empty(0)

    def errors(x: Array) -> Array:
        nonlocal last
        r = search.errors(x)
        if r is None:
            return np.full_like(last, np.inf)
        last = r
        return r / search.unit

    def slope(x: Array) -> Array:
        return search.jacobian(x, last) / search.unit

    # A tolerance below rounding is none; scipy wants it said so.
    objective, parameter = (t if t >= EPS else None for t in (o.objective_tolerance, o.parameter_tolerance))
    found = least_squares(
        errors,
        np.zeros(len(search.start.Q)),
        jac=slope,
        bounds=(-search.limit, search.limit),
        method="dogbox",
        ftol=objective,
        xtol=parameter,
        gtol=objective,
        max_nfev=o.max_passes,
    )
    why = ("", "its slope vanished", "it came to rest", "lambda came to rest", "it came to rest, and so did lambda")
    return "converged", why[found.status]


def _nelder_mead(search: PathSearch, o: Alg2Options) -> tuple[Status, str]:
    """Downhill simplex from the start and one step along each log lambda."""
    from scipy.optimize import minimize

    def value(x: Array) -> float:
        search.errors(x)
        return search.objectives[-1] / search.unit

    p = len(search.start.Q)
    minimize(
        value,
        np.zeros(p),
        method="Nelder-Mead",
        bounds=[(-search.limit, search.limit)] * p,
        options={
            "initial_simplex": np.vstack([np.zeros(p), min(SIMPLEX, search.limit) * np.eye(p)]),
            "xatol": o.parameter_tolerance,
            "fatol": o.objective_tolerance,
            "maxiter": o.max_passes,
            "maxfev": o.max_passes + 1,
            "adaptive": True,
        },
    )
    return "converged", "the simplex came to rest"


def _trace(search: PathSearch) -> dict[str, Array]:
    runs = len(search.path)
    return {
        "loglik": np.array(search.logliks),
        "Q": np.array([search.noise(x).Q for x in search.path]),
        "R": np.tile(search.start.R, (runs, 1, 1)),
        "change": np.array(search.steps),
        "extrapolated": np.zeros(runs),
        "accepted": np.array([float(i) for i in search.improved]),
        "objective": np.array(search.objectives),
    }


def _safeguards(search: PathSearch) -> list[str]:
    """Each safeguard that acted and each warning about the end, in a sentence."""
    out = []
    if search.divergences:
        out.append(f"{len(search.divergences)} trial values made the filter fail: first, {search.divergences[0]}")
    for name, value in zip(search.model.noises, search.path[search.best], strict=True):
        if abs(value) >= (1.0 - EDGE) * search.limit:
            out.append(
                f"the variance of {name} ended on the edge of its range, {np.exp(value):.3g} times the start's: the "
                "path error does not bound it on that side; widen `lambda_span` or start elsewhere to see"
            )
    return out

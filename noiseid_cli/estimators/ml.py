"""Direct maximum likelihood: any mix of Q, R, m0, P0 and model parameters, by the extended Kalman filter's gradient.

A few passes of EM lead the noise to the scale of the data, a quasi-Newton climb finds the maximum, and the observed
information there proves it: its Newton step must promise next to nothing. The same information gives standard errors.

Measured, seconds on one core, flexible robot of 8 states and 4000 samples: a run of the filter 0.015, the reverse run
that gives the exact gradient 0.022 whatever the number of unknowns, a pass of EM 0.039; differences need 2 d + 1 runs.
Ends that miss the best of 90 starts (9 small problems, factors 1e-3.5..1e3.5 on Q and on R), and the median number of
passes, for em_passes of 0: 2, 50; 1: 2, 51; 2: 3, 31; 3: 2, 32; 5: 4, 32; 8: 4, 35; 12: 4, 38. Hence 3. (That was with
another acceleration of EM; with the present one, on 9 harder problems, 3: 4, 42; 5: 3, 42; 8: 2, 42; 12: 1, 40.)
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Literal

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators import em
from noiseid_cli.estimators.coordinates import Coordinates
from noiseid_cli.estimators.data_check import check_data
from noiseid_cli.estimators.estimate import Columns, Estimate, Parameters, Progress, Series
from noiseid_cli.estimators.jagged import lifted
from noiseid_cli.estimators.likelihood import Likelihood, Point
from noiseid_cli.estimators.ml_search import End, search
from noiseid_cli.estimators.profile_likelihood import Profile, arranged, profile
from noiseid_cli.estimators.unknowns import ParameterUnknowns, Unknowns
from noiseid_cli.filters.ekf import extended_kalman_filter
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording

# So often EM may lead on from an end, see ``jagged``.
LIFTS = 3
# A parameter is at its bound within this share of the way from its start.
AT_BOUND = 1e-5


@dataclass(frozen=True)
class MlOptions:
    """Options of ``estimate``.

    Attributes:
        gradient: ``exact`` (reverse derivatives) or ``differences`` (central ones).
        em_passes: passes of EM before the climb, for the unknown noise; model parameters stay at their start there.
            With 0 there is no EM after the climb either, see ``jagged``.
        max_passes: give up after so many runs over the data, EM's and those for the information among them.
        loglik_tolerance: at the end the Newton step must promise at most this.
        profile: the unknown whose profile likelihood is wanted; None: no profile.
    """

    gradient: Literal["exact", "differences"] = "exact"
    em_passes: int = 3
    max_passes: int = 1000
    loglik_tolerance: float = 1e-3
    profile: Profile | None = None


def estimate(
    model: CompiledModel,
    recordings: Sequence[Recording],
    start: NoiseValues,
    unknowns: Unknowns,
    parameters: ParameterUnknowns | None = None,
    declared: Columns = (),
    options: MlOptions | None = None,
    progress: Progress | None = None,
) -> Estimate:
    """Identify noise values and model parameters by maximum likelihood.

    Args:
        model: the compiled model.
        recordings: the tests; lengths, intervals and missing outputs may differ.
        start: noise values to start from; known parts stay as they are.
        unknowns: what is estimated of them, with its structure.
        parameters: the model parameters that are estimated, with their bounds.
        declared: name, unit and description of each of ``model.parameters``; needed where parameters are estimated.
        options: see ``MlOptions``.
        progress: called after each pass.

    Returns:
        The estimate; ``parameters`` holds the model parameters with standard errors.

    Raises:
        EstimationError: the problem cannot be posed.
        FilterDivergedError: the filter fails at the start itself.
    """
    options = options or MlOptions()
    began = time.perf_counter()
    coordinates = _pose(model, recordings, start, unknowns, parameters or ParameterUnknowns(), declared)
    wanted = None
    if options.profile is not None:
        coordinates, wanted = arranged(coordinates, options.profile.unknown)
    likelihood = Likelihood(coordinates, recordings, options.gradient, progress)
    at_start = coordinates.unpack(coordinates.pack(start, coordinates.parameters.start))[1]
    loglik_start = sum(extended_kalman_filter(at_start, r, start, i).loglik for i, r in enumerate(recordings))
    warm = _warm_start(coordinates, at_start, recordings, options, progress)
    likelihood.passes = 1 + (0 if warm is None else warm.passes)
    noise = start if warm is None else warm.final
    end = search(
        likelihood, coordinates.pack(noise, coordinates.parameters.start), options.loglik_tolerance, options.max_passes
    )
    lifts: list[float] = []
    while options.em_passes > 0 and coordinates.has_noise and end.status == "converged" and len(lifts) < LIFTS:
        point = end.climb.point
        higher, passes = lifted(coordinates, recordings, point.z, point.loglik, options.loglik_tolerance)
        likelihood.passes += passes
        if higher is None:
            break
        end = search(likelihood, higher, options.loglik_tolerance, options.max_passes)
        lifts.append(end.climb.point.loglik - point.loglik)
    trace = _trace(coordinates, warm, likelihood.visited)
    series: tuple[Series, ...] = ()
    if options.profile is not None and wanted is not None and end.status == "converged":
        units = {name: unit for name, unit, _ in declared}
        wanted = replace(wanted, unit=units.get(wanted.name, "") if wanted.of == "parameter" else wanted.unit)
        series = (profile(likelihood, end.climb.point, end.information, wanted, options.profile),)
    final, _ = coordinates.unpack(end.climb.point.z)
    return Estimate(
        method="ml",
        status=end.status,
        reason=end.reason,
        start=start,
        final=final,
        loglik_start=float(loglik_start),
        loglik=end.climb.point.loglik,
        passes=likelihood.passes,
        seconds=time.perf_counter() - began,
        trace=trace,
        safeguards=tuple(_safeguards(likelihood, end, lifts, options)),
        settings=asdict(replace(options, profile=None)) | {"profile": _in_words(options.profile)},
        parameters=_parameters(coordinates, end, declared),
        series=series,
    )


def _in_words(asked: Profile | None) -> str:
    return "none" if asked is None else f"{asked.unknown}, {asked.points} points over {asked.span:g} standard errors"


def _pose(
    model: CompiledModel,
    recordings: Sequence[Recording],
    start: NoiseValues,
    unknowns: Unknowns,
    parameters: ParameterUnknowns,
    declared: Columns,
) -> Coordinates:
    """The coordinates of the problem, refused where it has no answer."""
    check_data(model, recordings, steps_needed=unknowns.Q is not None)
    places = [name for name, _, _ in declared]
    for name in parameters.names:
        if name not in places:
            raise EstimationError(
                f"{name} is not a parameter of {model.name}: {', '.join(places) or 'none is declared'}"
            )
    coordinates = Coordinates(unknowns, start, model, parameters, tuple(places.index(n) for n in parameters.names))
    if coordinates.has_noise or not len(parameters):
        unknowns.check(start)
    return coordinates


def _warm_start(
    coordinates: Coordinates,
    model: CompiledModel,
    recordings: Sequence[Recording],
    options: MlOptions,
    progress: Progress | None,
) -> Estimate | None:
    """A few passes of EM over the noise, with the filter's own linearisation, whose maximum is the likelihood's."""
    if options.em_passes == 0 or not coordinates.has_noise:
        return None
    em_options = em.EmOptions(linearisation="filtered", max_passes=options.em_passes)
    return em.estimate(model, recordings, coordinates.start, coordinates.unknowns, em_options, progress)


def _parameters(coordinates: Coordinates, end: End, declared: Columns) -> Parameters | None:
    """The model parameters with standard errors by the delta method; NaN at a bound or where the data say nothing."""
    p = len(coordinates.parameters)
    if p == 0:
        return None
    value, by = coordinates.values(end.climb.point.z)
    variance = np.diag(end.information.covariance())[-p:]
    with np.errstate(invalid="ignore"):
        errors = np.where(_at_bound(coordinates, value) != "", np.nan, np.sqrt(variance) * np.abs(by))
    names = tuple(declared[i] for i in coordinates.at)
    positive = tuple(bool(low == 0.0) for low in coordinates.parameters.lower)
    return Parameters(names, coordinates.parameters.start, value, errors, positive)


def _at_bound(coordinates: Coordinates, value: Array) -> np.ndarray[tuple[int], np.dtype[np.str_]]:
    """(p,) ``lower`` or ``upper`` where a parameter has run to its bound, empty elsewhere."""
    u = coordinates.parameters
    low = value - u.lower < AT_BOUND * (u.start - u.lower)
    high = u.upper - value < AT_BOUND * (u.upper - u.start)
    return np.where(np.isfinite(u.lower) & low, "lower", np.where(np.isfinite(u.upper) & high, "upper", ""))


def _trace(coordinates: Coordinates, warm: Estimate | None, visited: Sequence[Point]) -> dict[str, Array]:
    """EM's passes, then each point of the climb; a point is accepted where it is the best so far."""
    before = {} if warm is None else warm.trace
    loglik = np.array([p.loglik for p in visited])
    noises = [coordinates.unpack(p.z)[0] for p in visited]
    best = np.concatenate(([-np.inf], np.maximum.accumulate(loglik)[:-1]))
    parts = {
        "loglik": loglik,
        "Q": np.array([n.Q for n in noises]),
        "R": np.array([n.R for n in noises]),
        "accepted": (loglik >= best).astype(np.float64),
    }
    return {name: np.concatenate([before[name], part]) if before else part for name, part in parts.items()}


def _safeguards(likelihood: Likelihood, end: End, lifts: Sequence[float], options: MlOptions) -> list[str]:
    """Each safeguard that acted and each warning about the end, in a sentence."""
    out = []
    if lifts:
        times = "once" if len(lifts) == 1 else f"{len(lifts)} times"
        out.append(
            f"the log-likelihood is jagged: {times} the climb ended on a tooth, from which EM led on, to "
            f"{sum(lifts):.3g} more; ends of other starts may differ by as much as the teeth"
        )
    c = likelihood.coordinates
    if likelihood.failures:
        out.append(
            f"at {len(likelihood.failures)} points that were tried the filter fails: first, {likelihood.failures[0]}"
        )
    if options.gradient == "exact" and not likelihood.exact:
        out.append("the model has no exact gradient with this discretisation: central differences took its place")
    value, _ = c.values(end.climb.point.z)
    for name, side in zip(c.parameters.names, _at_bound(c, value), strict=True):
        if side:
            out.append(f"{name} has run to its {side} bound: it has no standard error there")
    open_ = [
        n for n, v in zip(end.information.names, np.diag(end.information.covariance()), strict=True) if np.isnan(v)
    ]
    if open_:
        out.append(f"the data do not determine {', '.join(open_)}: the log-likelihood has no maximum in it")
    return out

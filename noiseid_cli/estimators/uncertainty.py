"""Standard errors and intervals of an estimate, from the observed information.

The information is minus the derivative of the score (``score``, Fisher's identity), by central differences in the free
coordinates; figures that people read (standard deviations, correlations) get theirs by the delta method. Intervals are
taken where errors are nearest to normal: the log of a standard deviation, Fisher's z of a correlation. What sits on
the boundary gets a one-sided bound from the profile of the likelihood, see ``boundary``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from noiseid_cli.estimators.boundary import Profile, upper_bound
from noiseid_cli.estimators.em import EmOptions
from noiseid_cli.estimators.estimate import Uncertainty
from noiseid_cli.estimators.identifiability import Directions, directions, sentences
from noiseid_cli.estimators.quantities import Figure, figures
from noiseid_cli.estimators.score import Score, score
from noiseid_cli.estimators.unknowns import Unknowns
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording

# A step of the differences, in standard errors that the noise itself would give; and its greatest size.
STEP, LARGEST_STEP = 0.5, 0.05
# A log standard deviation with a greater standard error than this may be zero: its profile is asked.
DOUBTFUL = 0.5
# A direction of a covariance is gone below this share of the standard deviation that it belongs to.
GONE_PIVOT = 1e-6
# Beyond these the end is called off the maximum (in log-likelihood), and score and log-likelihood to disagree.
OFF_MAXIMUM, DISAGREEMENT = 0.1, 0.25
# Share of a figure's error along undetermined directions that makes it undetermined.
TOUCHED = 1e-3


def uncertainty(
    model: CompiledModel,
    recordings: Sequence[Recording],
    noise: NoiseValues,
    unknowns: Unknowns,
    level: float = 0.95,
    options: EmOptions | None = None,
    progress: Callable[[int, int], None] | None = None,
    observed: Callable[[Array], Array] | None = None,
) -> Uncertainty:
    """Standard errors of a maximum-likelihood estimate.

    Args:
        model, recordings: the problem.
        noise: the estimate.
        unknowns: what was estimated.
        level: confidence level of the intervals, between 0 and 1.
        options: of the EM that the estimate is from, of which the smoother counts; default: the extended one.
        progress: called with the number of passes done and of all, of which there are 2 d + 1.
        observed: gives the (d, d) observed information in place of the score's, from (d,) steps of its differences:
            that of the filter's own log-likelihood, as ``observed_information.marginal_information`` does.

    Raises:
        FilterDivergedError: the filter fails at the estimate, or a fraction of a standard error beside it.
        LinAlgError: an unknown covariance is singular.
    """
    options = options or EmOptions()
    weights = options.weights(model.nx)
    z = unknowns.pack(noise)
    here = score(model, recordings, noise, unknowns, weights)
    free = np.diag(here.complete) > 0.0
    steps = np.minimum(STEP / np.sqrt(np.where(free, np.diag(here.complete), 1.0)), LARGEST_STEP)
    sides: list[tuple[Score, Score]] = []
    for a in range(len(z) if observed is None else 0):
        moved = [unknowns.unpack(z + sign * steps[a] * np.eye(len(z))[a], noise) for sign in (-1.0, 1.0)]
        low, high = (score(model, recordings, point, unknowns, weights) for point in moved)
        sides.append((low, high))
        if progress is not None:
            progress(2 * a + 3, 2 * len(z) + 1)
    if observed is None:
        raw = np.array([(low.gradient - high.gradient) / (2 * h) for (low, high), h in zip(sides, steps, strict=True)])
        information = 0.5 * (raw + raw.T)
    else:
        information = observed(steps)
    gone = free & _gone_pivots(unknowns, noise)
    kept = free & ~gone
    found = _solve(information, here.complete, kept)
    shown = figures(model, unknowns, noise)
    zeros = _zeros(model, recordings, noise, unknowns, here, found, shown, level, options)
    held = ""
    if zeros and not found.determined.all():
        # What may be zero is flat, and would leave nothing of the others.
        kept &= ~np.any([_belongs(unknowns, noise, *zero) for zero in zeros], axis=0)
        found = _solve(information, here.complete, kept)
        held = "The standard errors of the others hold at its estimate what may be zero."
    told, ridges = sentences(found, shown, [_at_zero(f, zeros) for f in shown])
    remarks = [*ridges, *_boundary_remarks(unknowns, noise, gone)]
    remarks += _linearisation(here, sides, steps, found, kept) if observed is None else []
    remarks += [held] if held else []
    labels = _labels(model, unknowns, noise)
    rows = [_row(figure, found, zeros, level) for figure in shown]
    se, lower, upper = (np.array([row[k] for row in rows], dtype=np.float64) for k in range(3))
    return Uncertainty(
        method="score",
        level=level,
        names=tuple((f.metric, f.index, f.unit) for f in shown),
        values=np.array([f.value for f in shown]),
        standard_errors=se,
        lower=lower,
        upper=upper,
        notes=tuple(str(row[3]) for row in rows),
        coordinates=labels,
        information=information,
        shares=found.shares,
        directions=tuple(told),
        remarks=tuple(remarks),
    )


def quantile(probability: float) -> float:
    """Quantile of the standard normal distribution."""
    from scipy.special import ndtri

    return float(ndtri(probability))


def _solve(information: Array, complete: Array, kept: np.ndarray) -> Directions:
    """Eigen-directions over the coordinates that are kept, zero in the others."""
    part = np.ix_(kept, kept)
    found = directions(information[part], complete[part])
    vectors = np.zeros((len(kept), found.vectors.shape[1]))
    vectors[kept] = found.vectors
    return Directions(found.shares, vectors)


def _places(unknowns: Unknowns, noise: NoiseValues) -> list[tuple[str, tuple[int, int]]]:
    """Covariance and entry that each coordinate belongs to."""
    out = [
        (letter, place) for letter, structure, _ in unknowns.covariances(noise) for place in structure.coordinate_places
    ]
    return out + ([("m0", (i, i)) for i in range(noise.m0.shape[1])] if unknowns.m0 else [])


def _labels(model: CompiledModel, unknowns: Unknowns, noise: NoiseValues) -> tuple[str, ...]:
    names = {"Q": model.noises, "R": model.outputs, "P0": model.states, "m0": model.states}
    return tuple(
        f"{letter} {'factor' if i < 0 else names[letter][i] if i == j else f'{names[letter][i]}, {names[letter][j]}'}"
        for letter, (i, j) in _places(unknowns, noise)
    )


def _belongs(unknowns: Unknowns, noise: NoiseValues, letter: str, i: int) -> np.ndarray:
    """(d,) whether a coordinate speaks of noise i: none of them has a meaning once its variance is zero."""
    return np.array([at == letter and (i in place or place == (-1, -1)) for at, place in _places(unknowns, noise)])


def _gone_pivots(unknowns: Unknowns, noise: NoiseValues) -> np.ndarray:
    """(d,) whether a coordinate is the log of a pivot that has gone to zero: the covariance is singular there."""
    out = np.zeros(len(_places(unknowns, noise)), dtype=bool)
    at = 0
    for _, structure, (value,) in unknowns.covariances(noise):
        z, places = structure.coordinates(value), structure.coordinate_places
        if not (structure.scale or structure.is_linear):
            for k, (i, j) in enumerate(places):
                out[at + k] = i == j and np.exp(z[k]) < GONE_PIVOT * np.sqrt(value[i, i])
        at += len(places)
    return out


def _zeros(
    model: CompiledModel,
    recordings: Sequence[Recording],
    noise: NoiseValues,
    unknowns: Unknowns,
    here: Score,
    found: Directions,
    shown: Sequence[Figure],
    level: float,
    options: EmOptions,
) -> dict[tuple[str, int], float]:
    """Upper bound of each standard deviation of which the data do not exclude that it is zero."""
    out = {}
    drop = 0.5 * quantile(level) ** 2
    for figure in shown:
        if figure.scale != "log":
            continue
        error = _error(figure, found)
        if error is not None and error <= DOUBTFUL:
            continue
        profile = Profile(model, recordings, noise, unknowns, figure.letter, figure.place[0], options)
        bound = upper_bound(profile, here.loglik, drop)
        if bound is not None:
            out[figure.letter, figure.place[0]] = bound
    return out


def _at_zero(figure: Figure, zeros: dict[tuple[str, int], float]) -> bool:
    return any((figure.letter, i) in zeros for i in figure.place)


def _error(figure: Figure, found: Directions) -> float | None:
    """Standard error on the figure's own scale; None if it depends on what the data do not determine."""
    along = figure.scaled_slope @ found.vectors
    good = found.determined
    if np.any(np.abs(along[~good]) > TOUCHED * np.linalg.norm(along)):
        return None
    return float(np.sqrt(np.sum(along[good] ** 2 / found.shares[good])))


def _row(
    figure: Figure, found: Directions, zeros: dict[tuple[str, int], float], level: float
) -> tuple[float, float, float, str]:
    """Standard error, lower, upper and note of one figure."""
    if _at_zero(figure, zeros):
        if figure.scale == "log":
            upper = zeros[figure.letter, figure.place[0]]
            error = max(upper - figure.value, 0.0) / quantile(level)
            return error, 0.0, upper, "zero is not excluded: one-sided bound from the profile of the likelihood"
        return np.nan, *figure.whole, "not determined: a variance that it belongs to may be zero"
    error_or_none = _error(figure, found)
    if error_or_none is None:
        return np.nan, *figure.whole, "not determined: the likelihood has no maximum along a direction that moves it"
    lower, upper = figure.interval(error_or_none * quantile(0.5 + 0.5 * level))
    plain = {"log": figure.value, "fisher": 1.0 - figure.value**2, "plain": 1.0}[figure.scale]
    return error_or_none * plain, lower, upper, ""


def _boundary_remarks(unknowns: Unknowns, noise: NoiseValues, gone: np.ndarray) -> list[str]:
    letters = {letter for (letter, _), g in zip(_places(unknowns, noise), gone, strict=True) if g}
    return [
        f"{letter} is singular along a direction: the standard errors are those with it held so." for letter in letters
    ]


def _linearisation(
    here: Score, sides: Sequence[tuple[Score, Score]], steps: Array, found: Directions, kept: np.ndarray
) -> list[str]:
    """Is the end a maximum, and is the score that of the log-likelihood which the filter reports?

    The log-likelihoods beside the estimate come with the scores; on a linear model both agree.
    """
    slopes = np.array([(high.loglik - low.loglik) / (2 * h) for (low, high), h in zip(sides, steps, strict=True)])
    error = np.sqrt(np.diag(found.covariance))
    out = []
    gain = 0.5 * float(slopes @ found.covariance @ slopes)
    if gain > OFF_MAXIMUM:
        out.append(
            f"The end is off the maximum of the filter's log-likelihood, by about {gain:.2g}: standard errors are "
            "those at the end; more passes may get nearer, or `linearisation: filtered` where that is not set yet."
        )
    apart = float(np.max(np.abs(slopes - here.gradient)[kept] * error[kept], initial=0.0))
    if apart > DISAGREEMENT:
        out.append(
            f"The score of the smoother and the slope of the filter's log-likelihood differ by {apart:.2g} per "
            "standard error: the points of linearisation move with the noise values, so that these standard errors are "
            "approximate; `uncertainty: {method: bootstrap}` does without."
        )
    return out

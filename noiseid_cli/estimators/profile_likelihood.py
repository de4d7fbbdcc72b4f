"""Profile likelihood of one unknown: the greatest log-likelihood at each of its values, all else free.

Its shape says more than a standard error: where it leaves the parabola of the observed information, intervals from
standard errors mislead. The values that the likelihood-ratio test does not reject at 5 % lie above -1.92 (half the
chi-square quantile with one degree of freedom; Cox & Hinkley, Theoretical Statistics, 1974, ch. 9).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.coordinates import Coordinates
from noiseid_cli.estimators.estimate import Series
from noiseid_cli.estimators.likelihood import Likelihood, Point
from noiseid_cli.estimators.observed_information import Information
from noiseid_cli.estimators.quasi_newton import climb
from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.models.recording import Array

DROP = 1.92
# Standard error that stands in, in a free coordinate, where the data give none.
UNDETERMINED = 0.5


@dataclass(frozen=True)
class Profile:
    """What profile is asked.

    Attributes:
        unknown: a model parameter; or a noise, an output or a state, for its standard deviation.
        points: number of values, the maximum among them; rounded up to an odd number.
        span: distance of the outermost ones from the maximum, in standard errors.
    """

    unknown: str
    points: int = 15
    span: float = 3.0


@dataclass(frozen=True)
class Wanted:
    """The unknown whose profile is asked.

    Attributes:
        name, unit: of the unknown.
        place: its free coordinate.
        of: ``parameter``, or Q, R or P0 where it is the standard deviation of row ``row``.
    """

    name: str
    unit: str
    place: int
    of: str
    row: int = 0


def arranged(coordinates: Coordinates, name: str) -> tuple[Coordinates, Wanted]:
    """The coordinates, such that the unknown is one of them, and which.

    Args:
        coordinates: of the problem.
        name: a model parameter that is unknown; or a noise, an output or a state, for its standard deviation.

    Raises:
        EstimationError: it is not among the unknowns.
    """
    c, u = coordinates, coordinates.unknowns
    groups = (("Q", u.Q, c.model.noises), ("R", u.R, c.model.outputs), ("P0", u.P0, c.model.states))
    total, found = 0, None
    for letter, structure, names in groups:
        if structure is None:
            continue
        if found is None and name in names and (names.index(name), names.index(name)) not in structure.held:
            i = names.index(name)
            own = _first(structure, i)
            c = replace(c, unknowns=replace(u, **{letter: own}))  # type: ignore[arg-type]
            found = Wanted(name, c.model.units.get(name, ""), total + _place(own, i), letter, i)
        total += len(structure.coordinate_places)
    if name in c.parameters.names:
        total += c.model.nx if u.m0 else 0
        return coordinates, Wanted(name, "", total + c.parameters.names.index(name), "parameter")
    if found is None:
        known = [n for _, s, names in groups if s is not None for n in names]
        listed = ", ".join([*c.parameters.names, *known])
        raise EstimationError(f"profile: {name} is not an unknown; there are: {listed or 'none that has a profile'}")
    return c, found


def _first(structure: CovarianceStructure, i: int) -> CovarianceStructure:
    """The same structure with row i first in its block, where its standard deviation is a coordinate."""
    blocks = tuple((i, *(j for j in block if j != i)) if i in block else block for block in structure.blocks)
    return replace(structure, blocks=blocks)


def _place(structure: CovarianceStructure, i: int) -> int:
    """Place of the standard deviation of row i among the structure's coordinates."""
    if structure.scale:
        return 0
    first = next((group[0] for group in structure.tied if i in group), i)
    groups = [{(i, i), (first, first)} & {place} for place in structure.coordinate_places]
    return next(k for k, hit in enumerate(groups) if hit)


class _Slice:
    """A likelihood with one coordinate held."""

    def __init__(self, likelihood: Likelihood, place: int, z: Array) -> None:
        self._likelihood, self._place, self._z = likelihood, place, z

    def point(self, rest: Array) -> Point:
        z = np.insert(rest, self._place, self._z[self._place])
        found = self._likelihood.point(z)
        return Point(rest, found.loglik, np.delete(found.gradient, self._place))


def profile(likelihood: Likelihood, top: Point, information: Information, wanted: Wanted, asked: Profile) -> Series:
    """The profile on both sides of a maximum.

    Args:
        likelihood: of the problem.
        top: the maximum.
        information: observed information there.
        wanted: which unknown.
        asked: how many values, and how far.

    Returns:
        The log-likelihood less its maximum over the unknown's values, and the parabola of the information.
    """
    k = wanted.place
    covariance = information.covariance()
    error = float(np.sqrt(covariance[k, k])) if np.isfinite(covariance[k, k]) else UNDETERMINED
    half = max(asked.points // 2, 1)
    offsets = asked.span * error * np.arange(1, half + 1) / half
    down = _side(likelihood, top, covariance, k, -offsets)
    up = _side(likelihood, top, covariance, k, offsets)
    zs = np.concatenate([top.z[k] - offsets[::-1], [top.z[k]], top.z[k] + offsets])
    drops = np.concatenate([down[::-1], [0.0], up])
    at = np.array([_value(likelihood.coordinates, top.z, wanted, z) for z in zs])
    parabola = -0.5 * np.square((zs - top.z[k]) / error)
    order = np.argsort(at)
    what = wanted.name if wanted.of == "parameter" else f"the standard deviation of {wanted.name}"
    return Series(
        name=f"profile_{wanted.name}",
        title=f"Profile likelihood of {what}{_interval(at[order], drops[order])}",
        axis=(what.removeprefix("the "), wanted.unit),
        at=at[order],
        columns=(
            ("log-likelihood", "", "greatest log-likelihood at each value, less the maximum"),
            ("parabola", "", "what the observed information expects"),
        ),
        values=np.column_stack([drops, parabola])[order],
    )


def _side(likelihood: Likelihood, top: Point, covariance: Array, k: int, offsets: Array) -> Array:
    """Greatest log-likelihood less its maximum with coordinate k moved by each offset; each starts from the last."""
    usable = np.all(np.isfinite(covariance))
    rest = np.delete(np.arange(top.z.size), k)
    inverse, lean = None, np.zeros(rest.size)
    if usable:
        lean = covariance[rest, k] / covariance[k, k]
        inverse = covariance[np.ix_(rest, rest)] - np.outer(lean, covariance[k, rest])
    visited = len(likelihood.visited)
    z, out, before = top.z.copy(), [], 0.0
    for offset in offsets:
        z[rest] += lean * (offset - before)
        z[k] = top.z[k] + offset
        before = offset
        slice_ = _Slice(likelihood, k, z)
        start = slice_.point(z[rest])
        if not np.isfinite(start.loglik) or not np.all(np.isfinite(start.gradient)):
            out.append(np.nan)
            continue
        if rest.size:
            start = climb(slice_, start, inverse, tolerance=1e-4, step_tolerance=np.inf).point
            z[rest] = start.z
        out.append(start.loglik - top.loglik)
    del likelihood.visited[visited:]
    return np.array(out)


def _value(coordinates: Coordinates, z: Array, wanted: Wanted, at: float) -> float:
    """Value of the unknown where its coordinate is ``at``."""
    moved = z.copy()
    moved[wanted.place] = at
    if wanted.of == "parameter":
        p = len(coordinates.parameters)
        return float(coordinates.values(moved)[0][wanted.place - (z.size - p)])
    noise, _ = coordinates.unpack(moved)
    return float(np.sqrt(getattr(noise, wanted.of)[wanted.row, wanted.row]))


def _interval(at: Array, drops: Array) -> str:
    """The 95 % interval in words, where the profile falls far enough on both sides."""
    ends = [_crossing(at[::-1], drops[::-1]), _crossing(at, drops)]
    if None in ends:
        return ""
    return f"; 95 % interval {ends[0]:.4g} to {ends[1]:.4g}"


def _crossing(at: Sequence[float] | Array, drops: Sequence[float] | Array) -> float | None:
    """Where the profile falls through -1.92 beyond its maximum, by its root as a line; None if it does not."""
    top = int(np.nanargmax(drops))
    for i in range(top, len(drops) - 1):
        if drops[i + 1] < -DROP <= drops[i]:
            near, far = np.sqrt(max(-drops[i], 0.0)), np.sqrt(-drops[i + 1])
            share = (np.sqrt(DROP) - near) / (far - near)
            return float(at[i] + share * (at[i + 1] - at[i]))
    return None

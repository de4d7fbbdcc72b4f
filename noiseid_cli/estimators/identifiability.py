"""Which directions of the unknowns the data determine, in units of what the noise itself would tell.

The eigenvalues of the observed information relative to the complete-data information lie between 0 and 1 at a maximum:
each is the share of information that the recordings hold of what recordings of the noise would hold; one less that
share is the rate at which plain EM converges along the direction (Dempster, Laird & Rubin, JRSS B 39, 1977, sec. 3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from noiseid_cli.estimators.quantities import Figure
from noiseid_cli.models.recording import Array

# A share below this is none: rounding of the differenced score reaches about as far.
NOTHING = 1e-6
# A direction is a ridge if one standard error along it moves a std by this factor, or a correlation by so much.
RIDGE_FACTOR, RIDGE_CORRELATION = 2.0, 0.3
# At most so many directions are told; beyond the weakest only those with a share below this.
SHOWN, WEAK = 3, 0.1


@dataclass(frozen=True)
class Directions:
    """The eigen-directions of the information, weakest first.

    Attributes:
        shares: (d,) share of the complete-data information that the data hold.
        vectors: (d, d) directions in the columns, of one complete-data standard error each.
    """

    shares: Array
    vectors: Array

    @property
    def determined(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """(d,) whether the data hold anything."""
        return np.asarray(self.shares > NOTHING)

    @property
    def covariance(self) -> Array:
        """(d, d) inverse of the information over the directions that are determined."""
        good = self.determined
        half = self.vectors[:, good] / np.sqrt(self.shares[good])
        return np.asarray(half @ half.T)


def directions(information: Array, complete: Array) -> Directions:
    """Eigen-directions of the observed information relative to the complete-data information.

    Args:
        information: (d, d) observed information, symmetric.
        complete: (d, d) complete-data information, symmetric positive definite.
    """
    from scipy.linalg import eigh

    scale = np.sqrt(np.diag(complete))
    shares, vectors = eigh(information / np.outer(scale, scale), complete / np.outer(scale, scale))
    return Directions(np.asarray(shares), np.asarray(vectors / scale[:, None]))


def sentences(found: Directions, figures: Sequence[Figure], may_be_zero: Sequence[bool]) -> tuple[list[str], list[str]]:
    """The weakest directions in words, and the warnings among them.

    Args:
        found: the directions.
        figures: what is moved along them; slopes in the same coordinates.
        may_be_zero: of each figure, whether a variance that it belongs to may be zero: a step along the direction
            then means nothing, and is not told.

    Returns:
        One sentence a direction, at most ``SHOWN``; and those of them that are ridges.
    """
    told: list[str] = []
    ridges: list[str] = []
    bounded = {id(figure) for figure, zero in zip(figures, may_be_zero, strict=True) if zero}
    for k in range(len(found.shares)):
        share = float(found.shares[k])
        moved = _moved(figures, found.vectors[:, k] / np.sqrt(max(share, NOTHING)))
        if len(told) == SHOWN or not moved or (told and share > WEAK):
            break
        if any(id(figure) in bounded for figure, _ in moved):
            told.append(
                f"The data do not determine {_joined([f.in_words() for f, _ in moved])}: a variance among them may be "
                f"zero, and along one direction the data hold {_percent(share)} of what a recording of the noise "
                "itself would tell."
            )
            if len({i for figure, _ in moved for i in figure.place}) > 1:
                ridges.append(told[-1])
            continue
        if share <= NOTHING:
            text = f"The data say nothing about {_joined([f.in_words() for f, _ in moved])}"
            told.append(f"{text}: along that direction the likelihood has no maximum.")
            ridges.append(told[-1])
            continue
        ridge = any(_is_ridge(f, step) for f, step in moved)
        verb = "say little about" if ridge else "say least about" if not told else "say next least about"
        parts = _joined([f"{f.in_words()} ({_step(f, step)})" for f, step in moved])
        told.append(
            f"The data {verb} {parts}, moved by one standard error along one direction; they hold {_percent(share)} of "
            "what a recording of the noise itself would tell."
        )
        if ridge:
            ridges.append(told[-1])
    return told, ridges


def _moved(figures: Sequence[Figure], step: Array) -> list[tuple[Figure, float]]:
    """The figures that a step moves most, on their own scales."""
    moves = [(figure, float(figure.scaled_slope @ step)) for figure in figures]
    greatest = max((abs(m) for _, m in moves), default=0.0)
    most = [pair for pair in moves if abs(pair[1]) >= 0.5 * greatest > 0.0]
    most = sorted(most, key=lambda pair: -abs(pair[1]))[:3]
    # The sign of a direction is free: the first figure goes up.
    sign = 1.0 if not most or most[0][1] > 0.0 else -1.0
    return [(figure, sign * move) for figure, move in most]


def _is_ridge(figure: Figure, step: float) -> bool:
    if figure.scale == "log":
        return bool(abs(step) > np.log(RIDGE_FACTOR))
    return bool(figure.scale == "fisher" and abs(step) * (1.0 - figure.value**2) > RIDGE_CORRELATION)


def _step(figure: Figure, step: float) -> str:
    if figure.scale == "log":
        return f"× {np.exp(step):.3g}"
    if figure.scale == "fisher":
        return f"{step * (1.0 - figure.value**2):+.2f}"
    return f"{step:+.2g} {figure.unit}".rstrip()


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"


def _joined(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"

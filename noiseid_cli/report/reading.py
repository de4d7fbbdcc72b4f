"""What tables and figures read from results: standard deviations, correlations, and which units stand for all."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Literal, TypeVar

import numpy as np

from noiseid_cli.diagnostics.evaluation import Evaluation
from noiseid_cli.models.recording import Array
from noiseid_cli.outcome import UnitResult

At = Literal["tuning", "start", "estimate", "truth"]
Names = tuple[tuple[str, str, str], ...]
Key = TypeVar("Key", bound=Hashable)

PLACES: tuple[At, ...] = ("start", "estimate", "truth")
ALL_PLACES: tuple[At, ...] = ("tuning", *PLACES)
FEATURED = 4
"""At most so many units get curves and matrices of their own."""


def std(covariance: Array | None, i: int) -> float:
    """Standard deviation i of a covariance; NaN where there is none."""
    if covariance is None or not covariance[i, i] >= 0:
        return float("nan")
    return float(np.sqrt(covariance[i, i]))


def correlation(covariance: Array) -> Array:
    """(n, n) correlations; NaN in rows and columns of zero or unknown variance."""
    variance = np.diag(covariance)
    scale = np.sqrt(np.where(variance > 0, variance, np.nan))
    rho: Array = covariance / np.outer(scale, scale)
    return rho


def covariances(result: UnitResult, at: At) -> tuple[Array | None, Array | None]:
    """Q and R at one place; None for a truth that is not known."""
    if at == "truth":
        return result.Q_true, result.R_true
    if at == "tuning":
        return result.Q_tuning, result.R_tuning
    values = result.estimate.start if at == "start" else result.estimate.final
    return values.Q, values.R


def loglik(result: UnitResult, at: At) -> float:
    """Log-likelihood at one place: of the evaluation, else of the estimator; NaN where there is neither."""
    if at in result.evaluations:
        return result.evaluations[at].loglik
    own = {"start": result.estimate.loglik_start, "estimate": result.estimate.loglik}
    return own.get(at, float("nan"))


def reason(result: UnitResult, at: At) -> str:
    """Why a figure at one place has no value."""
    if at == "truth":
        return "The truth is not known" if result.Q_true is None else "The filter was not evaluated at the truth"
    if result.estimate.status != "converged":
        return f"Not available: the unit ended as {result.estimate.status}"
    return f"The filter was not evaluated at the {at} values"


def evaluation(result: UnitResult, at: At) -> Evaluation | None:
    """The filter at one place, where it was run."""
    return result.evaluations.get(at)


def converged(result: UnitResult) -> bool:
    """Whether the unit counts in means."""
    return result.estimate.status == "converged"


def remark(result: UnitResult, which: Literal["Q", "R"], i: int) -> str:
    """``held`` for a variance that kept its start value bit for bit while others moved; else what happened."""
    start, final = result.estimate.start, result.estimate.final
    moved_anything = not (np.array_equal(start.Q, final.Q) and np.array_equal(start.R, final.R))
    before, after = getattr(start, which)[i, i], getattr(final, which)[i, i]
    if before != after:
        return "estimated"
    return "held" if moved_anything else "unchanged"


def group(results: list[UnitResult], key: Callable[[UnitResult], Key]) -> dict[Key, list[UnitResult]]:
    """Results by a key, in order of first appearance."""
    groups: dict[Key, list[UnitResult]] = {}
    for result in results:
        groups.setdefault(key(result), []).append(result)
    return groups


def best(results: list[UnitResult]) -> list[UnitResult]:
    """The best converged unit of each dataset and method, of the first replicate; at most ``FEATURED``."""
    chosen = []
    for units in group(results, lambda r: (r.dataset, r.method_label)).values():
        first = [u for u in units if u.replicate == units[0].replicate]
        chosen.append(max(first, key=lambda u: (converged(u), np.nan_to_num(loglik(u, "estimate"), nan=-np.inf))))
    return chosen[:FEATURED]


def featured(results: list[UnitResult]) -> list[UnitResult]:
    """One or two units, else the best of each method and dataset."""
    return list(results) if len(results) <= 2 else best(results)


def covariance_unit(names: Names, i: int, j: int) -> str:
    """Unit of entry (i, j) of a covariance, such as ``(N m)^2`` or ``(rad) (m/s)``; empty for plain numbers."""
    a, b = names[i][1], names[j][1]
    if not a and not b:
        return ""
    return f"({a})^2" if a == b else f"({a or '1'}) ({b or '1'})"

"""The search of maximum likelihood: climbs, each proved or led on by the observed information at its end."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.ends import false_end
from noiseid_cli.estimators.estimate import Status
from noiseid_cli.estimators.likelihood import Likelihood
from noiseid_cli.estimators.observed_information import Information, information_at
from noiseid_cli.estimators.quasi_newton import Climb, climb
from noiseid_cli.models.recording import Array

# Climbs, each from the Newton step of the last one's information.
ROUNDS = 4
# Length of a step away from a saddle, in standard errors by its curvature.
SIDE = 0.3


@dataclass
class End:
    """Where a search ended: the climb, the information there, and how it came out."""

    climb: Climb
    information: Information
    status: Status
    reason: str


def search(likelihood: Likelihood, z: Array, tolerance: float, max_passes: int) -> End:
    """Climb, look at the information, go its Newton step; until that promises nothing.

    Args:
        likelihood: what is maximised; counts the passes.
        z: (d,) where it starts.
        tolerance: at the end the Newton step must promise at most this much log-likelihood.
        max_passes: give up after so many runs over the data.

    Raises:
        EstimationError: there is no log-likelihood or no slope at the start.
    """
    point = likelihood.point(z)
    if not np.isfinite(point.loglik):
        raise EstimationError(f"no log-likelihood at the start: {likelihood.failures[-1]}")
    if not np.all(np.isfinite(point.gradient)):
        raise EstimationError("the filter fails next to the start, so that no slope can be had there; start elsewhere")
    inverse = None
    for turn in range(ROUNDS):
        found = climb(likelihood, point, inverse, full=lambda: likelihood.passes >= max_passes)
        information = information_at(likelihood, found.point.z)
        newton, inverse = _newton(information, found)
        promise = 0.5 * float(found.point.gradient @ newton)
        uphill = information.uphill()
        end = Climb(found.point, inverse, promise, float(np.max(np.abs(newton), initial=0.0)), found.stop)
        if found.stop == "full":
            break
        sides = [newton] if uphill is None else [SIDE * uphill, -SIDE * uphill]
        tried = [likelihood.point(found.point.z + side) for side in sides]
        point = max([found.point, *tried], key=lambda p: p.loglik)
        if uphill is None and promise <= tolerance:
            end = replace(end, point=point)
            break
        if point is found.point or turn == ROUNDS - 1:
            break
    return End(end, information, *_verdict(likelihood, end, information, tolerance))


def _newton(information: Information, found: Climb) -> tuple[Array, Array]:
    """(d,) Newton step over what the data determine, and (d, d) inverse information for a further climb."""
    covariance = information.covariance()
    newton = np.where(np.isfinite(covariance), covariance, 0.0) @ found.point.gradient
    open_ = np.isnan(np.diag(covariance))
    covariance[open_], covariance[:, open_] = 0.0, 0.0
    covariance[open_, open_] = np.diag(found.inverse)[open_]
    return newton, covariance


def _verdict(likelihood: Likelihood, end: Climb, information: Information, tolerance: float) -> tuple[Status, str]:
    """How the search came out, in a word and in a sentence."""
    c = likelihood.coordinates
    noise, model = c.unpack(end.point.z)
    passes = f"after {likelihood.passes} passes"
    if end.stop == "full":
        return "max_passes", f"{likelihood.passes} passes were not enough: the climb still promises {end.promise:.2g}"
    gone = c.unknowns.gone(noise)
    if gone:
        return "stalled_fixed_point", (
            f"{passes} a standard deviation of {gone} has gone to zero: zero is its answer, or the start is too far "
            "off; start nearer to the data's scale, take more em_passes, or give it as known"
        )
    low = false_end(model, likelihood.recordings, c.unknowns, noise, end.point.loglik)
    if low:
        return "stalled_fixed_point", (
            f"{passes} the climb is on a plain, but a much greater {low} has the greater likelihood: "
            "start from a greater one, or take more em_passes"
        )
    if end.promise > tolerance or information.uphill() is not None:
        return "numerical", (
            f"{passes} no step raises the log-likelihood, though its slope promises {end.promise:.2g}: "
            "it is jagged there, or this is a saddle; another start tells"
        )
    return "converged", (
        f"{passes} the Newton step of the observed information promises {max(end.promise, 0.0):.2g} of log-likelihood "
        f"and changes no coordinate by more than {end.step:.2g}"
    )

"""EM with a Kalman smoother (axelsson2011_poster, Alg. 1), plain or accelerated.

E-step: ``em_statistics``; M-steps: ``unknowns`` and ``structure``. ``acceleration="none"`` is the paper's algorithm.
An acceleration proposes points between EM steps, in the free coordinates; a proposed point is kept only if the
log-likelihood does not fall there, and rest is declared after an EM step only: the fixed points are EM's own.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Literal, Protocol

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.data_check import check_data
from noiseid_cli.estimators.em_record import safeguards, trace
from noiseid_cli.estimators.em_run import EmPoint, EmRun
from noiseid_cli.estimators.em_statistics import LINEARISATIONS
from noiseid_cli.estimators.estimate import Estimate, Progress, Status
from noiseid_cli.estimators.quasi_newton_em import QuasiNewtonEm
from noiseid_cli.estimators.unknowns import GONE, Unknowns
from noiseid_cli.filters.ekf import FilterDivergedError
from noiseid_cli.filters.sigma_points import SigmaWeights, cubature, unscented
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording

# A fall below this share of the log-likelihood is rounding of its sum, not a fall.
ROUNDING = 1e-12


class Acceleration(Protocol):
    """What proposes points between the EM steps of a run."""

    def propose(self, now: EmPoint) -> NoiseValues | None:
        """A point to try from ``now``, where the last pass was made; None where an EM step is next."""

    def learn(self, tried: EmPoint | None) -> None:
        """What became of the proposed point; None where there was no pass, or none that ended."""


ACCELERATIONS: dict[str, Callable[[EmRun], Acceleration | None]] = {
    "quasi_newton": QuasiNewtonEm,
    "none": lambda _: None,
}
"""What ``EmOptions.acceleration`` can name."""


@dataclass(frozen=True)
class EmOptions:
    """Options of ``estimate``.

    Attributes:
        smoother: ``extended`` (the paper's), ``unscented`` or ``cubature``: what runs the E-step, and whose likelihood
            is reported.
        alpha, beta, kappa: weights of the unscented points, see ``sigma_points.unscented``; kappa None is 3 - nx. The
            default alpha is 1 [chosen]: with the customary 1e-3 the shift of the mean loses six of sixteen digits.
        linearisation: ``smoothed`` (the paper's) or ``filtered``, see ``em_statistics.e_step``; ``smoothed`` for
            sigma points, whose moments are always those of the smoothed distribution.
        acceleration: ``quasi_newton``, see ``quasi_newton_em``, or ``none``.
        max_passes: give up after so many passes over the data.
        loglik_tolerance: the log-likelihood counts as at rest when a pass changes it by at most this much.
        parameter_tolerance: so do the parameters when an EM step changes no log standard deviation and no
            correlation by more than this.
        stop: which of the two must be at rest; ``loglik`` with tolerance 0 is the paper's rule (no further rise).
        fall_tolerance: a fall of the log-likelihood up to this is accepted from the acceleration: the likelihood of an
            extended Kalman filter can be jagged.
    """

    smoother: Literal["extended", "unscented", "cubature"] = "extended"
    alpha: float = 1.0
    beta: float = 2.0
    kappa: float | None = None
    linearisation: Literal["smoothed", "filtered"] = "smoothed"
    acceleration: Literal["quasi_newton", "none"] = "quasi_newton"
    max_passes: int = 500
    loglik_tolerance: float = 1e-3
    parameter_tolerance: float = 1e-5
    stop: Literal["both", "loglik", "parameters"] = "both"
    fall_tolerance: float = 1e-3

    def weights(self, nx: int) -> SigmaWeights | None:
        """Sigma points of the smoother for nx states; None for the extended one.

        Raises:
            EstimationError: the weights are not usable.
        """
        if self.smoother == "extended":
            return None
        return cubature(nx) if self.smoother == "cubature" else unscented(nx, self.alpha, self.beta, self.kappa)

    def settings(self) -> dict[str, str | float | int]:
        """The options in force, without those that the smoother does not read."""
        idle = {"extended": {"alpha", "beta", "kappa"}, "cubature": {"alpha", "beta", "kappa", "linearisation"}}
        skip = idle.get(self.smoother, {"linearisation"})
        return {name: "3 - nx" if value is None else value for name, value in asdict(self).items() if name not in skip}


def estimate(
    model: CompiledModel,
    recordings: Sequence[Recording],
    start: NoiseValues,
    unknowns: Unknowns,
    options: EmOptions | None = None,
    progress: Progress | None = None,
) -> Estimate:
    """Identify the unknown noise values by EM.

    Args:
        model: the compiled model.
        recordings: the tests; lengths, intervals and missing outputs may differ.
        start: noise values to start from; known parts stay as they are.
        unknowns: what is estimated, with its structure.
        options: see ``EmOptions``.
        progress: called after each pass.

    Returns:
        The estimate; its ``final`` is the visited point of greatest log-likelihood.

    Raises:
        EstimationError: the problem cannot be posed (singular start, too few tests, dependent noise gains).
        FilterDivergedError: the filter fails at the start itself.
    """
    options = options or EmOptions()
    weights = options.weights(model.nx)
    if weights is not None and options.linearisation != "smoothed":
        raise EstimationError(
            f"linearisation {options.linearisation} belongs to the extended smoother: the {options.smoother} one takes "
            "its moments under the smoothed distribution"
        )
    check_data(model, recordings, steps_needed=unknowns.Q is not None)
    unknowns.check(start)
    began = time.perf_counter()
    linearisation = LINEARISATIONS[options.linearisation]
    run = EmRun(model, recordings, unknowns, linearisation, weights, options.fall_tolerance, progress)
    status, reason = _iterate(run, start, options)
    return Estimate(
        method="em",
        status=status,
        reason=reason,
        start=start,
        final=run.best.noise,
        loglik_start=run.points[0].loglik,
        loglik=run.best.loglik,
        passes=run.passes,
        seconds=time.perf_counter() - began,
        trace=trace(run),
        safeguards=tuple(safeguards(run, options.linearisation)),
        settings=options.settings(),
    )


def _iterate(run: EmRun, start: NoiseValues, options: EmOptions) -> tuple[Status, str]:
    """Until the stop rule holds: what the acceleration proposes where it does, else an EM step."""
    acceleration = ACCELERATIONS[options.acceleration](run)
    now = before = run.visit(start)
    confirm = False
    while run.passes < options.max_passes:
        proposed = None if acceleration is None or confirm else acceleration.propose(now)
        confirm = False
        if acceleration is not None and proposed is not None:
            tried = run.attempt(proposed, now.loglik)
            acceleration.learn(tried)
            if tried is not None and tried.accepted:
                before, now = now, tried
                ended = _gone(run, now)
                if ended is not None:
                    return ended
                confirm = _at_rest(before, now, options)
                continue
            if run.passes >= options.max_passes:
                break
        before = now
        try:
            now = run.visit(before.after)
        except FilterDivergedError as error:
            return "diverged", f"after an EM step {error}; the best point before it is kept"
        if now.loglik < before.loglik - ROUNDING * abs(before.loglik):
            run.falls.append(before.loglik - now.loglik)
        ended = _ended(run, before, now, options)
        if ended is not None:
            return ended
    return _out_of_passes(run, before, now, options)


def _ended(run: EmRun, before: EmPoint, now: EmPoint, options: EmOptions) -> tuple[Status, str] | None:
    """How the run ends with the EM step from ``before`` to ``now``; None where it goes on."""
    gone = _gone(run, now)
    if gone is not None or not _at_rest(before, now, options):
        return gone
    low = run.too_low(now)
    if low:
        return "stalled_fixed_point", _too_low(run, low)
    return "converged", (
        f"after {run.passes} passes the last EM step changed the log-likelihood by "
        f"{now.loglik - before.loglik:.2g} and no log standard deviation or correlation by more than "
        f"{now.change:.2g}"
    )


def _gone(run: EmRun, now: EmPoint) -> tuple[Status, str] | None:
    gone = run.unknowns.gone(now.noise)
    if not gone:
        return None
    return "stalled_fixed_point", (
        f"after {run.passes} passes a standard deviation of {gone} is below {GONE:g} of its start: zero "
        "is its answer, or the start is too far off; start nearer to the data's scale, or give it as known"
    )


def _at_rest(before: EmPoint, now: EmPoint, options: EmOptions) -> bool:
    """The stop rule; of an accelerated step it only says that an EM step is next, which decides."""
    loglik = now.loglik - before.loglik <= options.loglik_tolerance
    parameters = now.change <= options.parameter_tolerance
    return {"both": loglik and parameters, "loglik": loglik, "parameters": parameters}[options.stop]


def _out_of_passes(run: EmRun, before: EmPoint, now: EmPoint, options: EmOptions) -> tuple[Status, str]:
    # From a start as good as zero the moments are rounding: covariances creep, though the log-likelihood is at rest.
    rests = before is not now and abs(now.loglik - before.loglik) <= options.loglik_tolerance
    if rests and (low := run.too_low(now)):
        return "stalled_fixed_point", _too_low(run, low)
    return "max_passes", (
        f"{run.passes} passes were not enough: the last EM step still changes a log standard deviation or a "
        f"correlation by {now.change:.2g}"
    )


def _too_low(run: EmRun, low: str) -> str:
    return (
        f"after {run.passes} passes the log-likelihood moves no more, but a much greater {low} has the greater "
        "likelihood: the start was so small that EM takes it for zero; start from a greater one"
    )

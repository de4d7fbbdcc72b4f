"""EM with a Kalman smoother (axelsson2011_poster, Alg. 1), with or without SQUAREM acceleration.

E-step: ``em_statistics``; M-steps: ``unknowns`` and ``structure``. ``acceleration="none"`` is the paper's algorithm.
SQUAREM (Varadhan & Roland, Scand. J. Statist. 35, 2008, scheme S3) extrapolates two EM steps in the free coordinates;
an extrapolated point is kept only if the log-likelihood does not fall there, so that the fixed points are EM's own.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Literal

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.data_check import check_data
from noiseid_cli.estimators.em_statistics import LINEARISATIONS, Statistics, e_step
from noiseid_cli.estimators.ends import false_end
from noiseid_cli.estimators.estimate import Estimate, Progress, Status
from noiseid_cli.estimators.unknowns import GONE, Unknowns
from noiseid_cli.filters.ekf import FilterDivergedError
from noiseid_cli.filters.sigma_points import SigmaWeights, cubature, unscented
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording

# A fall below this share of the log-likelihood is rounding of its sum, not a fall.
ROUNDING = 1e-12
# First bound on the length of a jump, and the factor by which the bound moves (as in the authors' package).
GROWTH = 4.0


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
        acceleration: ``squarem`` or ``none``.
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
    acceleration: Literal["squarem", "none"] = "squarem"
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


@dataclass
class _Point:
    """A point, its log-likelihood, and the EM step from it."""

    noise: NoiseValues
    loglik: float
    after: NoiseValues
    change: float
    extrapolated: bool = False


@dataclass
class _Run:
    """One run over the data: counts passes, keeps the trace and the best point."""

    model: CompiledModel
    recordings: Sequence[Recording]
    unknowns: Unknowns
    options: EmOptions
    weights: SigmaWeights | None
    progress: Progress | None
    points: list[_Point] = field(default_factory=list)
    accepted: list[bool] = field(default_factory=list)
    falls: list[float] = field(default_factory=list)
    divergences: list[str] = field(default_factory=list)
    singular: int = 0
    longest: float = GROWTH

    def visit(self, noise: NoiseValues, extrapolated: bool = False) -> _Point:
        """One pass: log-likelihood at ``noise`` and the EM step from there."""
        structure = self.unknowns.R
        statistics: Statistics = e_step(
            self.model,
            self.recordings,
            noise,
            LINEARISATIONS[self.options.linearisation],
            None if structure is None else structure.block_of,
            self.weights,
        )
        after = self.unknowns.maximise(statistics, noise)
        point = _Point(noise, statistics.loglik, after, self.unknowns.change(noise, after), extrapolated)
        self.points.append(point)
        self.accepted.append(True)
        self.singular += statistics.singular
        if self.progress is not None:
            self.progress(len(self.points), point.loglik)
        return point

    def try_jump(self, first: _Point, second: _Point) -> _Point | None:
        """Extrapolate through two EM steps; None where the log-likelihood falls or the filter fails.

        The step length is bounded; the bound grows when it is reached with success, and shrinks at a rejection.
        """
        try:
            z0, z1, z2 = (self.unknowns.pack(n) for n in (first.noise, second.noise, second.after))
        except np.linalg.LinAlgError:
            # A covariance on its way to zero has no logarithm left to extrapolate.
            return None
        r, v = z1 - z0, z2 - 2.0 * z1 + z0
        curvature = float(np.linalg.norm(v))
        wanted = float(np.linalg.norm(r)) / curvature if curvature > 0.0 else 0.0
        length = min(wanted, self.longest)
        if length <= 1.0:
            # A length of 1 is the second EM step itself, which never needs a check.
            self.longest = max(self.longest, GROWTH)
            return None
        candidate = self.unknowns.unpack(z0 + 2.0 * length * r + length * length * v, first.noise)
        point = self._try(candidate, second.loglik)
        if point is None:
            self.longest = max(1.0, length / GROWTH)
        elif length == self.longest:
            self.longest *= GROWTH
        return point

    def _try(self, candidate: NoiseValues, least: float) -> _Point | None:
        """The point at ``candidate`` if it is usable and its log-likelihood not below ``least``."""
        if not _usable(candidate):
            return None
        try:
            point = self.visit(candidate, extrapolated=True)
        except FilterDivergedError as error:
            self.divergences.append(str(error))
            return None
        if point.loglik < least - self.options.fall_tolerance:
            self.accepted[-1] = False
            return None
        return point

    def at_rest(self, before: _Point, now: _Point) -> bool:
        """The stop rule, asked after a plain EM step from ``before`` to ``now``."""
        o = self.options
        rise = now.loglik - before.loglik
        loglik = rise <= o.loglik_tolerance
        parameters = now.change <= o.parameter_tolerance
        return {"both": loglik and parameters, "loglik": loglik, "parameters": parameters}[o.stop]

    def too_low(self, now: _Point) -> str:
        """Name of a covariance that is too small by powers of ten; empty if none is."""
        return false_end(self.model, self.recordings, self.unknowns, now.noise, now.loglik, self.weights)

    @property
    def full(self) -> bool:
        """The passes are used up."""
        return len(self.points) >= self.options.max_passes


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
    run = _Run(model, recordings, unknowns, options, weights, progress)
    status, reason = _iterate(run, start)
    best = max(run.points, key=lambda p: p.loglik)
    return Estimate(
        method="em",
        status=status,
        reason=reason,
        start=start,
        final=best.noise,
        loglik_start=run.points[0].loglik,
        loglik=best.loglik,
        passes=len(run.points),
        seconds=time.perf_counter() - began,
        trace=_trace(run),
        safeguards=tuple(_safeguards(run, best)),
        settings=options.settings(),
    )


def _iterate(run: _Run, start: NoiseValues) -> tuple[Status, str]:
    """Steps until the stop rule holds; two EM steps, then a jump where acceleration is on."""
    now = before = run.visit(start)
    while not run.full:
        before = now
        try:
            now = run.visit(before.after)
        except FilterDivergedError as error:
            return "diverged", f"after an EM step {error}; the best point before it is kept"
        if now.loglik < before.loglik - ROUNDING * abs(before.loglik):
            run.falls.append(before.loglik - now.loglik)
        gone = run.unknowns.gone(now.noise)
        if gone:
            return "stalled_fixed_point", (
                f"after {len(run.points)} passes a standard deviation of {gone} is below {GONE:g} of its start: zero "
                "is its answer, or the start is too far off; start nearer to the data's scale, or give it as known"
            )
        if run.at_rest(before, now):
            low = run.too_low(now)
            if low:
                return "stalled_fixed_point", _too_low(run, low)
            return "converged", (
                f"after {len(run.points)} passes the last EM step changed the log-likelihood by "
                f"{now.loglik - before.loglik:.2g} and no log standard deviation or correlation by more than "
                f"{now.change:.2g}"
            )
        if run.options.acceleration == "squarem" and not run.full:
            jumped = run.try_jump(before, now)
            now = now if jumped is None else jumped
    # From a start as good as zero the moments are rounding: covariances creep, though the log-likelihood is at rest.
    rests = before is not now and abs(now.loglik - before.loglik) <= run.options.loglik_tolerance
    if rests and (low := run.too_low(now)):
        return "stalled_fixed_point", _too_low(run, low)
    return "max_passes", (
        f"{len(run.points)} passes were not enough: the last EM step still changes a log standard deviation or a "
        f"correlation by {now.change:.2g}"
    )


def _too_low(run: _Run, low: str) -> str:
    return (
        f"after {len(run.points)} passes the log-likelihood moves no more, but a much greater {low} has the greater "
        "likelihood: the start was so small that EM takes it for zero; start from a greater one"
    )


def _usable(noise: NoiseValues) -> bool:
    """All covariances are finite and positive definite (only held entries can make one indefinite)."""
    for P in (noise.Q, noise.R, noise.P0):
        if not np.all(np.isfinite(P)):
            return False
        scale = np.sqrt(np.diag(P))
        if np.any(scale > 0.0):
            kept = scale > 0.0
            correlation = P[np.ix_(kept, kept)] / np.outer(scale[kept], scale[kept])
            if np.linalg.eigvalsh(correlation)[0] < -1e-12:
                return False
    return True


def _trace(run: _Run) -> dict[str, Array]:
    return {
        "loglik": np.array([p.loglik for p in run.points]),
        "Q": np.array([p.noise.Q for p in run.points]),
        "R": np.array([p.noise.R for p in run.points]),
        "change": np.array([p.change for p in run.points]),
        "extrapolated": np.array([float(p.extrapolated) for p in run.points]),
        "accepted": np.array([float(a) for a in run.accepted]),
    }


def _safeguards(run: _Run, best: _Point) -> list[str]:
    """Each safeguard that acted and each warning about the end, in a sentence."""
    out = []
    rejected = run.accepted.count(False)
    if rejected:
        out.append(f"{rejected} extrapolated points lowered the log-likelihood and were rejected")
    if run.divergences:
        out.append(f"{len(run.divergences)} extrapolated points made the filter fail: first, {run.divergences[0]}")
    if run.falls:
        other = "linearisation: filtered" if run.options.linearisation == "smoothed" else "linearisation: smoothed"
        other = other if run.weights is None else "smoother: extended"
        out.append(
            f"the log-likelihood fell in {len(run.falls)} plain EM steps, by {max(run.falls):.3g} at most: an "
            f"approximate E-step gives no guarantee; the best point was kept; `{other}` may do better"
        )
    if run.singular:
        out.append(f"{run.singular} predicted covariances were singular (a state was exactly known)")
    for name, structure, value in (("Q", run.unknowns.Q, best.noise.Q), ("R", run.unknowns.R, best.noise.R)):
        if structure is None:
            continue
        scale = np.sqrt(np.diag(structure.start))
        spread = np.linalg.eigvalsh(value / np.outer(scale, scale))
        if spread[0] < 1e-8 * spread[-1]:
            out.append(
                f"{name} is going to zero along one direction (eigenvalue ratio {spread[0] / spread[-1]:.1g}): zero is "
                "a fixed point of EM, so this can be the answer or a false end; another start tells"
            )
    return out

"""From a method's name and options to its run: the one table of what `estimate` can call."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from noiseid_cli.config.methods import EmOptions, MethodOptions
from noiseid_cli.errors import EstimationError

if TYPE_CHECKING:
    from noiseid_cli.estimators.estimate import Estimate, Progress
    from noiseid_cli.estimators.unknowns import ParameterUnknowns, Unknowns
    from noiseid_cli.filters.sigma_points import SigmaWeights
    from noiseid_cli.models.compiled import CompiledModel
    from noiseid_cli.models.equations import Model
    from noiseid_cli.models.noise import NoiseValues
    from noiseid_cli.models.recording import Recording


@dataclass(frozen=True)
class Task:
    """What a method is given.

    Attributes:
        model, recordings: model and data.
        equations: the model's equations, of which ``model`` is the compiled form.
        start: noise values to start from, the known ones among them.
        unknowns: which parts of the noise values are estimated.
        parameters: which of the model's parameters are estimated.
        options: the method's options by name.
        progress: called after each pass.
    """

    model: CompiledModel
    equations: Model
    recordings: Sequence[Recording]
    start: NoiseValues
    unknowns: Unknowns
    parameters: ParameterUnknowns
    options: dict[str, Any]
    progress: Progress | None


def run_method(name: str, task: Task) -> Estimate:
    """Run a method by its name.

    Raises:
        EstimationError: the method cannot estimate what is asked; it names those that can.
        FilterDivergedError: the filter fails at the start.
    """
    _refuse_what_it_cannot(name, task)
    return _METHODS[name](task)


def filter_of(options: MethodOptions, nx: int) -> tuple[str, SigmaWeights | None]:
    """The Kalman filter that a method's estimate is of: its name, and its sigma points for nx states if it has any."""
    from noiseid_cli.estimators import em

    if not isinstance(options, EmOptions):
        return "extended", None
    own = em.EmOptions(**options.model_dump(exclude={"method", "structure"}))
    return own.smoother, own.weights(nx)


def _refuse_what_it_cannot(name: str, task: Task) -> None:
    from noiseid_cli.config.methods import KINDS, METHOD_OPTIONS

    asked = {
        "Q": task.unknowns.Q is not None,
        "R": task.unknowns.R is not None,
        "m0": task.unknowns.m0,
        "P0": task.unknowns.P0 is not None,
        "parameters": len(task.parameters) > 0,
    }
    wanted = {kind for kind, is_asked in asked.items() if is_asked}
    beyond = wanted - METHOD_OPTIONS[name].can
    if beyond:
        others = [other for other, options in METHOD_OPTIONS.items() if wanted <= options.can]
        able = f"these can: {', '.join(others)}" if others else "no method estimates all that is asked"
        places = ", ".join(f"estimate.{KINDS[kind]}" for kind in KINDS if kind in beyond)
        raise EstimationError(f"{name} cannot estimate what {places} asks for: give it as known, or {able}")


def _em(t: Task) -> Estimate:
    from noiseid_cli.estimators import em

    return em.estimate(t.model, t.recordings, t.start, t.unknowns, em.EmOptions(**t.options), t.progress)


def _alg2(t: Task) -> Estimate:
    from noiseid_cli.estimators import alg2

    if t.unknowns.Q is None:
        raise EstimationError("alg2 estimates Q: give process_noise a start in place of known, or use em")
    if not t.unknowns.Q.is_diagonal:
        raise EstimationError(
            "alg2 estimates a diagonal Q with every variance free: give it `structure: diagonal` and hold no entry, "
            "or use em or alg3"
        )
    return alg2.estimate(t.model, t.recordings, t.start, alg2.Alg2Options(**t.options), t.progress)


def _alg3(t: Task) -> Estimate:
    from noiseid_cli.estimators import alg3

    return alg3.estimate(t.model, t.recordings, t.start, t.unknowns, alg3.Alg3Options(**t.options), t.progress)


_METHODS: dict[str, Callable[[Task], Estimate]] = {"em": _em, "alg2": _alg2, "alg3": _alg3}

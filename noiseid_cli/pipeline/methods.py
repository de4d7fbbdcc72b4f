"""From a method's name and options to its run: the one table of what `estimate` can call."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from noiseid_cli.errors import EstimationError

if TYPE_CHECKING:
    from noiseid_cli.estimators.estimate import Estimate, Progress
    from noiseid_cli.estimators.unknowns import Unknowns
    from noiseid_cli.models.compiled import CompiledModel
    from noiseid_cli.models.noise import NoiseValues
    from noiseid_cli.models.recording import Recording

Run = Callable[
    ["CompiledModel", "Sequence[Recording]", "NoiseValues", "Unknowns", dict[str, Any], "Progress | None"], "Estimate"
]


def run_method(
    name: str,
    model: CompiledModel,
    recordings: Sequence[Recording],
    start: NoiseValues,
    unknowns: Unknowns,
    options: dict[str, Any],
    progress: Progress | None,
) -> Estimate:
    """Run a method by its name.

    Raises:
        EstimationError: the method cannot estimate what is asked; it names those that can.
        FilterDivergedError: the filter fails at the start.
    """
    return _METHODS[name](model, recordings, start, unknowns, options, progress)


def _em(
    model: CompiledModel,
    recordings: Sequence[Recording],
    start: NoiseValues,
    unknowns: Unknowns,
    options: dict[str, Any],
    progress: Progress | None,
) -> Estimate:
    from noiseid_cli.estimators import em

    return em.estimate(model, recordings, start, unknowns, em.EmOptions(**options), progress)


def _alg2(
    model: CompiledModel,
    recordings: Sequence[Recording],
    start: NoiseValues,
    unknowns: Unknowns,
    options: dict[str, Any],
    progress: Progress | None,
) -> Estimate:
    from noiseid_cli.estimators import alg2

    if unknowns.Q is None or unknowns.R is not None or unknowns.P0 is not None or unknowns.m0:
        raise EstimationError("alg2 estimates Q and nothing else: give the rest as known, or use em")
    if not unknowns.Q.is_diagonal:
        raise EstimationError(
            "alg2 estimates a diagonal Q with every variance free: give it `structure: diagonal` and hold no entry, "
            "or use em or alg3"
        )
    return alg2.estimate(model, recordings, start, alg2.Alg2Options(**options), progress)


def _alg3(
    model: CompiledModel,
    recordings: Sequence[Recording],
    start: NoiseValues,
    unknowns: Unknowns,
    options: dict[str, Any],
    progress: Progress | None,
) -> Estimate:
    from noiseid_cli.estimators import alg3

    return alg3.estimate(model, recordings, start, unknowns, alg3.Alg3Options(**options), progress)


_METHODS: dict[str, Run] = {"em": _em, "alg2": _alg2, "alg3": _alg3}

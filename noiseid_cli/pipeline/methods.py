"""From a method's name and options to its run: the one table of what `estimate` can call."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from noiseid_cli.config.method_base import MethodOptions
from noiseid_cli.config.methods import EmOptions
from noiseid_cli.config.methods_online import OnlineOptions
from noiseid_cli.errors import EstimationError
from noiseid_cli.pipeline.ensembles import FirstStateLaw, ensemble

if TYPE_CHECKING:
    from noiseid_cli.estimators.estimate import Estimate, Progress
    from noiseid_cli.estimators.unknowns import ParameterUnknowns, Unknowns
    from noiseid_cli.filters.sigma_points import SigmaWeights
    from noiseid_cli.models.compiled import CompiledModel
    from noiseid_cli.models.equations import Model
    from noiseid_cli.models.noise import NoiseValues
    from noiseid_cli.models.recording import Recording


ENSEMBLES = ("batch-ml", "recursive-ml")
"""The methods for ensembles of tests, whose first states have a law of their own."""

CONTINUED = ("recursive-ml",)
"""The methods that go on from an earlier result when new recordings come."""


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
        first: what is said of the first state beside its mean and covariance; for the methods for ensembles.
        state: what an earlier run of the same method left, to go on from.
    """

    model: CompiledModel
    equations: Model
    recordings: Sequence[Recording]
    start: NoiseValues
    unknowns: Unknowns
    parameters: ParameterUnknowns
    options: dict[str, Any]
    progress: Progress | None
    first: FirstStateLaw = field(default_factory=FirstStateLaw)
    state: dict[str, Any] = field(default_factory=dict)


def run_method(name: str, task: Task) -> Estimate:
    """Run a method by its name.

    Raises:
        EstimationError: the problem cannot be posed.
        FilterDivergedError: the filter fails at the start.
    """
    if name not in ENSEMBLES:
        _refuse_what_is_for_ensembles(name, task)
    if task.state and name not in CONTINUED:
        raise EstimationError(f"{name} cannot go on from a result; these can: {', '.join(CONTINUED)}")
    return _METHODS[name](task)


def filter_of(options: MethodOptions, nx: int) -> tuple[str, SigmaWeights | None]:
    """The Kalman filter that a method's estimate is of: its name, and its sigma points for nx states if it has any."""
    from noiseid_cli.estimators import em

    if isinstance(options, OnlineOptions):
        from noiseid_cli.filters.sigma_points import unscented

        joint = options.method == "joint-srukf"  # its kappa counts the parameters as states
        return "unscented", unscented(nx, options.alpha, options.beta, None if joint else options.kappa)
    if not isinstance(options, EmOptions):
        return "extended", None
    own = em.EmOptions(**options.model_dump(exclude={"method", "structure"}))
    return own.smoother, own.weights(nx)


def _refuse_what_is_for_ensembles(name: str, task: Task) -> None:
    them = " and ".join(ENSEMBLES)
    if task.first.given:
        raise EstimationError(
            f"{name} takes neither estimate.initial_map nor estimate.common_bias: they are for {them}"
        )
    if task.equations.discretisation == "van_loan":
        raise EstimationError(
            f"{task.equations.name} is driven by white noise, which is for {them}: {name} takes a noise that is held "
            "over each interval; give model.discretisation: exact"
        )
    if task.start.m0.shape[1] != task.model.nx:
        raise EstimationError(
            f"the model {task.equations.name} gives the covariance of a part of its first state itself, which is for "
            f"{them}: {name} takes the mean and covariance of every state; give a model without initial_covariance"
        )


def _em(t: Task) -> Estimate:
    from noiseid_cli.estimators import em

    return em.estimate(t.model, t.recordings, t.start, t.unknowns, em.EmOptions(**t.options), t.progress)


def _alg2(t: Task) -> Estimate:
    from noiseid_cli.estimators import alg2

    return alg2.estimate(t.model, t.recordings, t.start, alg2.Alg2Options(**t.options), t.progress)


def _alg3(t: Task) -> Estimate:
    from noiseid_cli.estimators import alg3

    return alg3.estimate(t.model, t.recordings, t.start, t.unknowns, alg3.Alg3Options(**t.options), t.progress)


def _ml(t: Task) -> Estimate:
    from noiseid_cli.estimators import ml
    from noiseid_cli.estimators.profile_likelihood import Profile

    asked = t.options["profile"]
    options = ml.MlOptions(**t.options | {"profile": None if asked is None else Profile(**asked)})
    declared = tuple((p.name, p.unit, p.description) for p in t.equations.parameters)
    return ml.estimate(t.model, t.recordings, t.start, t.unknowns, t.parameters, declared, options, t.progress)


def _adaptive(t: Task, monitor: bool) -> Estimate:
    from noiseid_cli.estimators import adaptive_estimate
    from noiseid_cli.estimators.adaptive_srukf import AdaptiveOptions

    options = AdaptiveOptions(**t.options, monitor=monitor)
    return adaptive_estimate.estimate(
        t.equations, t.model, t.recordings, t.start, t.unknowns, t.parameters, options, t.progress
    )


def _asrukf(t: Task) -> Estimate:
    return _adaptive(t, monitor=False)


def _sb_asrukf(t: Task) -> Estimate:
    return _adaptive(t, monitor=True)


def _joint_srukf(t: Task) -> Estimate:
    from noiseid_cli.estimators import joint_srukf

    options = joint_srukf.JointOptions(**{k: v for k, v in t.options.items() if k != "hold_process_noise"})
    return joint_srukf.estimate(t.equations, t.model, t.recordings, t.start, t.parameters, options, t.progress)


def _batch_ml(t: Task) -> Estimate:
    from noiseid_cli.estimators.cross_sectional.batch import BatchOptions
    from noiseid_cli.estimators.cross_sectional.method import batch

    options = dict(t.options)
    at_tests = options.pop("at_tests")
    return batch(ensemble(t), BatchOptions(**options), t.progress, at_tests)


def _recursive_ml(t: Task) -> Estimate:
    from noiseid_cli.estimators.cross_sectional.method import recursive
    from noiseid_cli.estimators.cross_sectional.recursive_state import RecursiveOptions, RecursiveState

    state = RecursiveState.from_arrays(t.state) if t.state else None
    return recursive(ensemble(t), RecursiveOptions(**t.options), t.progress, state)


_METHODS: dict[str, Callable[[Task], Estimate]] = {
    "em": _em,
    "ml": _ml,
    "alg2": _alg2,
    "alg3": _alg3,
    "asrukf": _asrukf,
    "sb-asrukf": _sb_asrukf,
    "joint-srukf": _joint_srukf,
    "batch-ml": _batch_ml,
    "recursive-ml": _recursive_ml,
}

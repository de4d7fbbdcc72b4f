"""From a task to an ensemble of tests."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from noiseid_cli.errors import EstimationError

if TYPE_CHECKING:
    from noiseid_cli.config.schema_estimate import Estimate as EstimateSection
    from noiseid_cli.estimators.cross_sectional.ensemble import Ensemble, FirstState
    from noiseid_cli.estimators.cross_sectional.problem import CommonBias
    from noiseid_cli.estimators.estimate import Columns
    from noiseid_cli.models.equations import Model
    from noiseid_cli.models.recording import Array, Recording
    from noiseid_cli.pipeline.methods import Task


@dataclass(frozen=True)
class FirstStateLaw:
    """What the experiment says of the first state beside its mean and covariance.

    Attributes:
        names: of the components of b; empty for the states that the model leaves free.
        matrix: T for all tests; tests: T by test. Both None for the free states themselves.
        common: bias that tests share; outputs: those that have it.
    """

    names: tuple[str, ...] = ()
    matrix: Array | None = None
    tests: dict[str, Array] | None = None
    common: CommonBias | None = None
    outputs: tuple[str, ...] = ()

    @classmethod
    def of(cls, section: EstimateSection) -> FirstStateLaw:
        """Read the section."""
        from noiseid_cli.estimators.cross_sectional.problem import CommonBias

        chosen, bias = section.initial_map, section.common_bias
        common = None
        if bias is not None:
            first = bias.first.matrix()
            common = CommonBias(first, np.zeros_like(first) if bias.walk is None else bias.walk.matrix())
        outputs = () if bias is None else tuple(bias.outputs)
        if chosen is None:
            return cls(common=common, outputs=outputs)
        matrix = None if chosen.matrix is None else np.array(chosen.matrix)
        tests = None if chosen.tests is None else {name: np.array(T) for name, T in chosen.tests.items()}
        return cls(tuple(chosen.names), matrix, tests, common, outputs)

    @property
    def given(self) -> bool:
        """Something is said that only the methods for ensembles can take."""
        return bool(self.names) or self.common is not None


def ensemble(task: Task) -> Ensemble:
    """Pose the ensemble of a task.

    Raises:
        EstimationError: what is asked is not among the unknowns that these methods take; it says what is.
    """
    from noiseid_cli.estimators.cross_sectional.ensemble import Ensemble, check_first
    from noiseid_cli.estimators.cross_sectional.problem import Coordinates, Theta
    from noiseid_cli.estimators.data_check import check_data
    from noiseid_cli.models.linear_family import LinearFamily
    from noiseid_cli.models.linearity import nonlinearity
    from noiseid_cli.models.schemes import DENSITY

    u, model = task.unknowns, task.equations
    check_data(task.model, task.recordings, steps_needed=False)
    if not u.m0 or u.P0 is None:
        raise EstimationError(
            "batch-ml and recursive-ml estimate the mean and the covariance of the first state together: give both "
            "initial_mean and initial_covariance a start"
        )
    first = _first_state(task)
    check_first(first, task.recordings, len(model.states))
    linear = not nonlinearity(model.equations())
    if not linear and len(task.parameters):
        raise EstimationError(
            f"{model.name} is not linear: batch-ml and recursive-ml then estimate the first state and variances only, "
            "not parameters of the model"
        )
    if not linear and first.common is not None:
        raise EstimationError("common_bias is for linear models")
    process = _variances(u.Q, "process_noise")
    measurement = _variances(u.R, "measurement_noise")
    posed = copy(model)
    posed.values = model.values | dict(zip(task.parameters.names, task.parameters.start.tolist(), strict=True))
    density = task.model.scheme >= DENSITY and model.discretisation != "van_loan"
    family = LinearFamily(
        posed, task.parameters.names, task.start.Q, task.start.R, process, measurement, density=density
    )
    structure: Literal["full", "diagonal"] = "full" if len(u.P0.blocks) == 1 and len(first.columns) > 1 else "diagonal"
    coordinates = Coordinates(len(first.columns), len(family.start), structure, _all_positive(task))
    return Ensemble(
        family=family,
        compiled=None if linear else task.model,
        recordings=tuple(task.recordings),
        first=first,
        start=Theta(task.start.m0[0], task.start.P0, family.start),
        coordinates=coordinates,
        alpha_names=_alpha_names(task, process, measurement),
    )


def _first_state(task: Task) -> FirstState:
    from noiseid_cli.estimators.cross_sectional.ensemble import FirstState
    from noiseid_cli.pipeline.first_state import selection

    law, model, recordings = task.first, task.equations, task.recordings
    columns: Columns
    if not law.names:
        columns = tuple((q.name, q.unit, q.description) for q in model.free_first_states)
        maps = (selection(model),) * len(recordings)
    else:
        columns = tuple((name, "1", "component of the first state") for name in law.names)
        maps = tuple(_map(law, recording) for recording in recordings)
    if law.common is None:
        return FirstState(columns, maps)
    E = np.eye(len(model.outputs))[:, [[q.name for q in model.outputs].index(name) for name in law.outputs]]
    return FirstState(columns, maps, law.common, E)


def _map(law: FirstStateLaw, recording: Recording) -> Array:
    if law.matrix is not None:
        return law.matrix
    assert law.tests is not None
    if recording.name not in law.tests:
        raise EstimationError(
            f"estimate.initial_map.tests has no matrix for test {recording.name!r}; it has {', '.join(law.tests)}"
        )
    return law.tests[recording.name]


def _variances(structure: object, what: str) -> tuple[int, ...]:
    """Indices of the free variances of a diagonal covariance; none where it is known."""
    from noiseid_cli.estimators.structure import CovarianceStructure

    if structure is None:
        return ()
    assert isinstance(structure, CovarianceStructure)
    n = len(structure.start)
    if len(structure.blocks) != n or np.count_nonzero(structure.start - np.diag(np.diag(structure.start))):
        raise EstimationError(
            f"batch-ml and recursive-ml estimate a diagonal {what}: give it `structure: diagonal`, or use em or ml"
        )
    return tuple(i for i in range(n) if (i, i) not in structure.held)


def _all_positive(task: Task) -> bool:
    """All alpha are positive, so that their logarithms are estimated.

    Raises:
        EstimationError: some are and some are not, or a bound is neither 0 nor absent.
    """
    p = task.parameters
    for name, lower, upper in zip(p.names, p.lower, p.upper, strict=True):
        if lower not in (0.0, -np.inf) or upper != np.inf:
            raise EstimationError(
                f"estimate.parameters.{name}: batch-ml and recursive-ml know the bound `lower: 0` only; ml knows others"
            )
    positive = p.lower == 0.0
    variances = task.unknowns.Q is not None or task.unknowns.R is not None
    if not positive.all() and (positive.any() or variances):
        raise EstimationError(
            "batch-ml and recursive-ml want parameters that are all positive (`lower: 0`) or all free, and positive "
            "ones beside unknown variances"
        )
    return bool(positive.all())


def _alpha_names(task: Task, process: tuple[int, ...], measurement: tuple[int, ...]) -> Columns:
    model: Model = task.equations
    by_name = {p.name: p for p in model.parameters}
    own = [(name, by_name[name].unit, by_name[name].description) for name in task.parameters.names]
    for indices, quantities, what in ((process, model.noises, "process"), (measurement, model.outputs, "measurement")):
        for i in indices:
            q = quantities[i]
            own.append((f"variance {q.name}", f"({q.unit})^2", f"variance of the {what} noise, {q.description}"))
    return tuple(own)

"""From the `estimate` section and a dataset to start values and unknowns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.estimators.unknowns import ParameterUnknowns, Unknowns
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Dataset

if TYPE_CHECKING:
    from noiseid_cli.config.schema_estimate import Estimate
    from noiseid_cli.config.schema_model import MarkovNoise
    from noiseid_cli.config.schema_unknowns import CovarianceChoice, MeanChoice
    from noiseid_cli.models.compiled import CompiledModel
    from noiseid_cli.models.equations import Model


def pose(
    section: Estimate,
    dataset: Dataset,
    model: CompiledModel,
    factors: Sequence[float] = (),
    measurement_factor: float = 1.0,
    first: Sequence[str] | None = None,
) -> tuple[NoiseValues, Unknowns]:
    """Start values and unknowns of one estimation unit.

    Args:
        section: the experiment's `estimate` section.
        dataset: the data.
        model: names the noises, outputs and states.
        factors: (nv,) factor on each variance of the process noise's start; all 1 if not given.
        measurement_factor: factor on the start of the measurement noise.
        first: what the initial mean and covariance are about; the states if not given.

    Raises:
        EstimationError: ``truth`` is asked of recordings that have none, or a test is not named.
    """
    Q, unknown_Q = _covariance(section.process_noise, model.noises, "process_noise", factors)
    same = (measurement_factor,) * model.ny
    R, unknown_R = _covariance(section.measurement_noise, model.outputs, "measurement_noise", same)
    P0, unknown_P0 = _covariance(section.initial_covariance, first or model.states, "initial_covariance")
    m0 = _mean(section.initial_mean, dataset)
    unknowns = Unknowns(Q=unknown_Q, R=unknown_R, P0=unknown_P0, m0=section.initial_mean.start is not None)
    return NoiseValues(Q, R, m0, P0), unknowns


def pose_parameters(section: Estimate) -> ParameterUnknowns:
    """The model's parameters that are estimated."""
    chosen = section.parameters.values()
    return ParameterUnknowns(
        names=tuple(section.parameters),
        start=np.array([c.start for c in chosen], dtype=float),
        lower=np.array([-np.inf if c.lower is None else c.lower for c in chosen], dtype=float),
        upper=np.array([np.inf if c.upper is None else c.upper for c in chosen], dtype=float),
    )


def check_time_constants(markov: MarkovNoise | None, discretisation: str, dataset: Dataset) -> None:
    """Refuse a Markov process that forgets within a sample, which euler and rk4 cannot step.

    Args:
        markov: the experiment's `model.markov_noise`.
        discretisation: the scheme in force.
        dataset: the data.

    Raises:
        EstimationError: a time constant is not above the typical interval of a test.
    """
    if markov is None or discretisation not in ("euler", "rk4"):
        return
    for r in dataset.recordings:
        interval = float(np.median(r.dt)) if len(r.dt) else 0.0
        for name, tau in markov.time_constants.items():
            if tau <= interval:
                raise EstimationError(
                    f"model.markov_noise: the time constant of {name}, {tau:g} s, is not above the interval of test "
                    f"{r.name!r}, {interval:.3g} s: between samples such a noise is white; leave it white, or take a "
                    "longer time constant"
                )


INTERVAL_TOLERANCE = 0.01
"""Largest relative difference between the sample time of a model and the interval of its data; chosen."""


def check_sample_time(model: Model, dataset: Dataset) -> None:
    """Refuse data at another interval than that which a parameter of the model stands for.

    Args:
        model: the model; only one with a ``sample_time_parameter`` is checked.
        dataset: the data.

    Raises:
        EstimationError: the typical interval of a test differs from the parameter.
    """
    name = model.sample_time_parameter
    if not name:
        return
    value = model.values[name]
    for r in dataset.recordings:
        interval = float(np.median(r.dt)) if len(r.dt) else value
        if abs(interval - value) > INTERVAL_TOLERANCE * value:
            raise EstimationError(
                f"the samples of test {r.name!r} are {interval:.6g} s apart, but {name}, the sample time of "
                f"{model.name}, is {value:.6g} s: set model.parameters.{name} to {interval:.6g}"
            )


def _covariance(
    choice: CovarianceChoice, names: Sequence[str], what: str, factors: Sequence[float] = ()
) -> tuple[Array, CovarianceStructure | None]:
    """Value and, where it is unknown, structure of one covariance."""
    if choice.known is not None:
        return choice.known.matrix(), None
    assert choice.start is not None
    # Correlations stay as they are given.
    f = np.sqrt(factors if factors else (1.0,) * len(names))
    tied = tuple(tuple(names.index(n) for n in group) for group in choice.tied)
    for group in tied:
        # What is tied starts at one variance, whatever the factors.
        f[list(group)] = f[group[0]]
    start = choice.start.matrix() * np.outer(f, f)
    if choice.structure == "scale":
        return start, CovarianceStructure.scaled(start, what)
    if choice.structure == "full":
        blocks: tuple[tuple[int, ...], ...] = (tuple(range(len(names))),)
    elif choice.structure == "diagonal":
        blocks = tuple((i,) for i in range(len(names)))
    else:
        listed = tuple(tuple(sorted(names.index(n) for n in block)) for block in choice.structure.blocks)
        alone = tuple((i,) for i in range(len(names)) if not any(i in block for block in listed))
        blocks = listed + alone
    held = set()
    for entry in choice.fixed:
        i, j = (names.index(n) for n in ((entry, entry) if isinstance(entry, str) else entry))
        held.add((max(i, j), min(i, j)))
        # A held entry keeps the value that the config gives, whatever the start is scaled by.
        start[i, j] = start[j, i] = choice.start.matrix()[i, j]
    return start, CovarianceStructure(start, blocks, held=frozenset(held), tied=tied, what=what)


def _mean(choice: MeanChoice, dataset: Dataset) -> Array:
    """(tests, nx) mean of the first state."""
    value = choice.known if choice.known is not None else choice.start
    if value == "truth":
        known = [r.x_true for r in dataset.recordings]
        if any(x is None for x in known):
            raise EstimationError(f"dataset {dataset.name} has no true states: give estimate.initial_mean as numbers")
        return np.array([x[0] for x in known if x is not None])
    if isinstance(value, dict):
        missing = [r.name for r in dataset.recordings if r.name not in value]
        if missing:
            raise EstimationError(
                f"estimate.initial_mean names no state for test {missing[0]!r} of dataset {dataset.name}; "
                f"named: {', '.join(value)}"
            )
        return np.array([value[r.name] for r in dataset.recordings], dtype=float)
    return np.tile(np.array(value, dtype=float), (len(dataset.recordings), 1))

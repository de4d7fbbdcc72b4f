"""What accelerations of EM are measured on: the shipped systems, with their shipped starts or worse ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from b_linear_em import problem as five_states

from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.estimators.unknowns import Unknowns
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.linear import linear_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Dataset, Recording
from noiseid_cli.pipeline.context import Context, open_experiment
from noiseid_cli.pipeline.datasets import make_dataset
from noiseid_cli.pipeline.problem import pose
from noiseid_cli.pipeline.units import dataset_units

CONFIGS = Path(__file__).parents[1] / "configs"
ONE = "simulate.replicates=1"
Posed = tuple[CompiledModel, tuple[Recording, ...], NoiseValues, Unknowns]


@dataclass(frozen=True)
class Problem:
    """One row of the table.

    Attributes:
        name: for readers.
        pose: gives model, recordings, start and unknowns.
        options: of EM, beside the acceleration.
    """

    name: str
    pose: Callable[[], Posed]
    options: dict[str, Any] = field(default_factory=dict)


def opened(file: str, overrides: Sequence[str], data: int = 0) -> tuple[Context, Dataset]:
    """A shipped experiment with EM as its method, and one of its datasets; the file of that is thrown away."""
    with TemporaryDirectory() as folder:
        context = open_experiment(CONFIGS / file, Path(folder), (*overrides, "estimate.methods={em: {}}"))
        return context, make_dataset(context, dataset_units(context)[data])


def shipped(file: str, *overrides: str, data: int = 0, factor: float = 1.0) -> Posed:
    """A problem of a shipped experiment; ``factor`` multiplies the start of the process noise."""
    context, dataset = opened(file, overrides, data)
    assert context.experiment.estimate is not None
    factors = (factor,) * len(context.model.noises)
    return context.compiled, dataset.recordings, *pose(context.experiment.estimate, dataset, context.compiled, factors)


def level(steps: float, start: float) -> Posed:
    """Q and R of a level seen through noise; with steps of zero its answer has no Q."""
    rng = np.random.default_rng(0)
    y = steps * np.cumsum(rng.normal(size=1000)) + 3.0 * rng.normal(size=1000)
    noise = NoiseValues(start * np.eye(1), np.eye(1), np.zeros((1, 1)), np.eye(1) * 10.0)
    return linear(linear_model(A=[[1.0]], G=[[1.0]], C=[[1.0]]), y[:, None], noise)


def five() -> Posed:
    """Q and R, both full, of five states seen in two outputs: benchmark (b)."""
    A, C, y, noise = five_states(500)
    return linear(linear_model(A, np.eye(5), C), y, noise)


def linear(model: CompiledModel, y: np.ndarray, noise: NoiseValues) -> Posed:
    """Q and R, both full."""
    recording = Recording("test", np.ones(len(y) - 1), np.zeros((len(y), 0)), y)
    return model, (recording,), noise, Unknowns(CovarianceStructure.full(noise.Q), CovarianceStructure.full(noise.R))


def ensemble() -> Posed:
    """Q, R, and the mean and covariance of the first state, of 20 tests of the Markov manipulator."""
    density = "{diag: [1], unit: density}"
    settings = ("model.discretisation=exact", "estimate.parameters={}", f"simulate.process_noise={density}",
                "estimate.measurement_noise={start: {diag: [0.1]}}",
                f"estimate.process_noise={{start: {density}}}")  # fmt: skip
    context, dataset = opened("porter1983.yaml", settings)
    tests = dataset.recordings
    noise = NoiseValues(np.eye(1) * 0.1, np.eye(1) * 0.1, np.zeros((len(tests), 3)), np.eye(3) * 0.5)
    Q, R, P0 = (CovarianceStructure.diagonal(value) for value in (noise.Q, noise.R, noise.P0))
    return context.compiled, tests, noise, Unknowns(Q, R, P0, m0=True)


def known_start(variances: list[float]) -> tuple[str, ...]:
    """Settings for a test of Riva et al. (2017) as a problem for EM: a shorter one, known from its first state on."""
    return (
        "simulate.samples=2000", ONE, "estimate.parameters={}", "estimate.initial_mean={known: truth}",
        f"estimate.initial_covariance={{known: {{diag: {variances}}}}}",
    )  # fmt: skip


ROBOT = partial(shipped, "quickstart.yaml", "simulate.samples=600")
DIAGONAL = "estimate.process_noise.structure=diagonal"
TIED = "estimate.process_noise={structure: diagonal, start: {std: [5, 5, 5, 5]}, tied: [[va1, va2], [vm1, vm2]]}"
ACCELEROMETERS = "estimate.measurement_noise={structure: diagonal, start: {diag: [1e-11, 1e-11, 1e-2, 1e-2]}}"
ONE_LINK = (
    *known_start([1e-6, 1e-4]), "simulate.parameter_changes=[]",
    "estimate.process_noise={structure: diagonal, start: {diag: [1e-9, 1e-3]}}",
    "estimate.measurement_noise={structure: diagonal, start: {diag: [5e-6, 50]}}",
)  # fmt: skip
PENDUBOT = (
    *known_start([1e-6, 1e-4, 1e-6, 1e-4]),
    "estimate.process_noise={structure: diagonal, start: {diag: [1e-8, 1e-6, 1e-8, 1e-6]}}",
    "estimate.measurement_noise={structure: diagonal, start: {diag: [5e-6, 5e-6, 10]}}",
)
SWING_UP = "import.recordings.swing_up.rows=[1, 4000]"
FILTERED = {"linearisation": "filtered"}
TIGHT = {"loglik_tolerance": 1e-6, "parameter_tolerance": 1e-6}

PROBLEMS = (
    Problem("robot, Q diagonal, start / 100", partial(ROBOT, DIAGONAL, factor=0.01)),
    Problem("robot, Q diagonal, start x 100", partial(ROBOT, DIAGONAL, factor=100.0)),
    Problem("robot, Q full, start / 100", partial(ROBOT, factor=0.01)),
    Problem("robot, Q full, start x 100", partial(ROBOT, factor=100.0)),
    Problem("robot, Q full, start x 100, filtered", partial(ROBOT, factor=100.0), FILTERED),
    Problem("robot, Q full and R, start / 100", partial(ROBOT, ACCELEROMETERS, factor=0.01)),
    Problem("robot, Q full and R, start x 100, filtered", partial(ROBOT, ACCELEROMETERS, factor=100.0), FILTERED),
    Problem("robot, Q tied in pairs", partial(ROBOT, TIED)),
    Problem("robot, Q diagonal, unscented", partial(ROBOT, DIAGONAL, factor=0.01), {"smoother": "unscented"}),
    Problem("one link, Q and R", partial(shipped, "riva2017_one_link.yaml", *ONE_LINK)),
    Problem("one link, Q and R, filtered", partial(shipped, "riva2017_one_link.yaml", *ONE_LINK), FILTERED),
    Problem("pendubot, Q and R", partial(shipped, "riva2017_pendubot.yaml", *PENDUBOT)),
    Problem("pendubot, Q and R, filtered", partial(shipped, "riva2017_pendubot.yaml", *PENDUBOT), FILTERED),
    Problem("level, Q and R", partial(level, 1.0, 0.05), FILTERED),
    Problem("level, Q going to zero", partial(level, 0.0, 1.0), FILTERED),
    Problem("Nile, Q and R", partial(shipped, "local_level.yaml"), TIGHT),
    Problem("five states, Q and R full", five, FILTERED),
    Problem("two states, Q full and R", partial(shipped, "validation/linear_two_state.yaml", ONE)),
    Problem("noise of rank one, Q and R", partial(shipped, "validation/rank_one.yaml", ONE), TIGHT),
    Problem("Markov manipulator, Q, R, m0 and P0", ensemble),
    Problem("double pendulum, excited", partial(shipped, "double_pendulum_measured.yaml"), FILTERED),
    Problem("double pendulum, its friction left out",
            partial(shipped, "validation/friction_left_out.yaml"), FILTERED),
    Problem("double pendulum, swing-up", partial(shipped, "double_pendulum_measured.yaml", SWING_UP, data=1), FILTERED),
    Problem("double pendulum, coloured noise",
            partial(shipped, "coloured_noise.yaml", SWING_UP, "estimate.parameters={}"), FILTERED),
)  # fmt: skip

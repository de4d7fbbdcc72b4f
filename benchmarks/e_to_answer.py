"""(e) Time to the answer: passes and seconds until the log-likelihood is within 0.01 of the maximum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from robot import P0, Q, R, robot_data
from timing import seconds

from noiseid_cli.estimators import em, ml
from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.estimators.unknowns import Unknowns
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.linear import linear_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording

NEAR = 0.01
Problem = tuple[CompiledModel, list[Recording], NoiseValues, Unknowns]


def robot() -> Problem:
    """Four process noises of the flexible robot, from a start 100 times too small in Q."""
    model, recording, _ = robot_data(2000)
    assert recording.x_true is not None
    start = NoiseValues(Q / 100.0, R, recording.x_true[:1], P0)
    return model, [recording], start, Unknowns(Q=CovarianceStructure.diagonal(start.Q))


def level() -> Problem:
    """Q and R of a level seen through noise."""
    rng = np.random.default_rng(0)
    y = np.cumsum(rng.normal(size=1000)) + 3.0 * rng.normal(size=1000)
    model = linear_model(A=[[1.0]], G=[[1.0]], C=[[1.0]])
    recording = Recording("level", np.ones(999), np.zeros((1000, 0)), y[:, None])
    start = NoiseValues(np.eye(1) * 0.05, np.eye(1), np.zeros((1, 1)), np.eye(1) * 10.0)
    return model, [recording], start, Unknowns(CovarianceStructure.full(start.Q), CovarianceStructure.full(start.R))


def to_answer(problem: Problem) -> dict[str, tuple[int, float]]:
    """Passes and seconds of each method."""
    model, recordings, start, unknowns = problem
    tight = em.EmOptions(loglik_tolerance=1e-6, parameter_tolerance=1e-7, max_passes=3000, linearisation="filtered")
    runs = {
        "EM, plain": lambda: em.estimate(model, recordings, start, unknowns, replace(tight, acceleration="none")),
        "EM, quasi-Newton": lambda: em.estimate(model, recordings, start, unknowns, tight),
        "ml": lambda: ml.estimate(model, recordings, start, unknowns),
    }
    found = {}
    for name, run in runs.items():
        run()  # compiles
        found[name] = min((run() for _ in range(3)), key=lambda result: result.seconds)
    best = max(result.loglik for result in found.values())
    out = {}
    for name, result in found.items():
        reached = np.asarray(result.trace["loglik"]) >= best - NEAR
        passes = int(np.argmax(reached)) + 1 if reached.any() else 0
        out[name] = (passes, result.seconds * passes / result.passes)
    return out


def rows() -> list[list[str]]:
    """Both problems."""
    table = []
    for label, problem in (("flexible robot, N = 2000", robot()), ("level, N = 1000", level())):
        for i, (name, (passes, spent)) in enumerate(to_answer(problem).items()):
            when = f"{passes} passes, {seconds(spent)}" if passes else "not reached"
            table.append([f"e. within {NEAR} of the maximum, {label}" if i == 0 else "", name, when, ""])
    return table

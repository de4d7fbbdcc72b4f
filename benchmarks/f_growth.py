"""(f) How the cost grows with the samples, the states, the tests and the threads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from d_ensembles import problem
from robot import robot_data
from timing import seconds, side_by_side

from noiseid_cli.estimators.cross_sectional.evaluate import partitioned
from noiseid_cli.estimators.em_statistics import e_step
from noiseid_cli.models.linear import linear_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording
from noiseid_cli.models.threads import use_threads

SAMPLES = (1_000, 10_000, 100_000, 1_000_000)
JOINTS = (1, 2, 4, 8, 16, 24)
TESTS = (1, 10, 100, 1_000, 10_000)
THREADS = (1, 2)


def chain(joints: int, samples: int = 500) -> tuple[object, list[Recording], NoiseValues]:
    """A chain of flexible joints, four states each, every angle measured and a torque noise on every motor and arm."""
    n, dt = 4 * joints, 1e-3
    A, G, C = np.eye(n), np.zeros((n, 2 * joints)), np.zeros((2 * joints, n))
    for j in range(2 * joints):
        A[2 * j, 2 * j + 1] = dt
        G[2 * j + 1, j] = C[j, 2 * j] = 1.0
        A[2 * j + 1, 2 * j] -= 200.0 * dt
        A[2 * j + 1, 2 * j + 1] -= 2.0 * dt
        if j:
            A[2 * j + 1, 2 * j - 2] += 100.0 * dt
    y = np.random.default_rng(joints).normal(size=(samples, 2 * joints))
    noise = NoiseValues(np.eye(2 * joints), np.eye(2 * joints), np.zeros((1, n)), np.eye(n))
    return linear_model(A, G, C), [Recording("chain", np.full(samples - 1, dt), np.zeros((samples, 0)), y)], noise


def rows() -> list[list[str]]:
    """Time of one pass over each range."""
    table = []

    def add(label: str, sizes: tuple[int, ...], make) -> None:  # type: ignore[no-untyped-def]
        times = side_by_side({str(size): make(size) for size in sizes}, runs=15, budget=3.0)
        parts = [f"{size:,}: {seconds(times[str(size)])}" for size in sizes]
        table.append([label, "; ".join(parts), "", ""])

    def whole(samples: int):  # type: ignore[no-untyped-def]
        model, recording, noise = robot_data(samples)
        return lambda: e_step(model, [recording], noise)

    def threaded(count: int):  # type: ignore[no-untyped-def]
        model, recording, noise = robot_data(2000)
        tests = [replace(recording, name=f"test-{i}") for i in range(8)]
        shared = replace(noise, m0=np.repeat(noise.m0, 8, axis=0))

        def run() -> None:
            with use_threads(count):
                e_step(model, tests, shared)

        return run

    def states(n: int):  # type: ignore[no-untyped-def]
        model, recordings, noise = chain(n // 4)
        return lambda: e_step(model, recordings, noise)

    def ensemble(tests: int):  # type: ignore[no-untyped-def]
        posed = problem(2, tests)
        return lambda: partitioned(*posed)

    add("f. EM pass, flexible robot, by samples", SAMPLES, whole)
    add("f. EM pass, chain of joints, N = 500, by states", tuple(4 * j for j in JOINTS), states)
    add("f. ensemble, two unknown starts, by tests", TESTS, ensemble)
    add("f. EM pass, eight robot tests of 2000, by threads", THREADS, threaded)
    return table

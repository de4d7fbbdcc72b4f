"""One pass of EM on the flexible robot: noiseid's kernels against the textbook form in NumPy, side by side.

Both run the extended Kalman filter, the smoother and the M-step statistics on the same data in the same process; the
figure is the ratio of their medians. `make bench` runs it.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "oracles"))

from covariance_form import filter_twin, measure, smoother_twin, step

from noiseid_cli.estimators.em_statistics import e_step
from noiseid_cli.models.compile import compile_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.registry import load_model
from noiseid_cli.simulation.motions import Square, plan_motion
from noiseid_cli.simulation.simulate import simulate

SAMPLES = 2000
Q = np.diag([50.0, 20.0, 30.0, 15.0]) ** 2
R = np.diag([1e-12, 1e-12, 1e-3, 1e-3])
P0 = np.diag([1e-6] * 4 + [1e-3] * 4)


def textbook_pass(model, recording, noise) -> np.ndarray:
    """Filter, smoother and M-step statistics as in a textbook: covariances, inverses, a Python loop."""
    twin = filter_twin(model, recording, noise)
    m, P, lag = smoother_twin(twin)
    total = np.zeros((model.nv, model.nv))
    for k in range(recording.samples - 1):
        x_next, J, G = step(model, m[k], recording.u[k], recording.dt[k])
        r = m[k + 1] - x_next
        M = P[k + 1] - lag[k] @ J.T - J @ lag[k].T + J @ P[k] @ J.T + np.outer(r, r)
        left = np.linalg.pinv(G)
        total += left @ M @ left.T
        measure(model, m[k], recording.u[k])
    return total / (recording.samples - 1)


def median_time(function: Callable[[], object], runs: int) -> float:
    """Median wall-clock time of a call, s; the first call, which may compile, is not counted."""
    function()
    times = []
    for _ in range(runs):
        began = time.perf_counter()
        function()
        times.append(time.perf_counter() - began)
    return statistics.median(times)


def main() -> None:
    """Run both and print the table."""
    robot = load_model("flexible_robot")
    model = compile_model(robot)
    plan = plan_motion("square", Square(), robot, model, SAMPLES)
    recordings = simulate(robot, model, plan, Q, R, seed=1, samples=SAMPLES).recordings
    assert recordings[0].x_true is not None
    noise = NoiseValues(Q, R, recordings[0].x_true[:1], P0)
    ours = median_time(lambda: e_step(model, recordings, noise), 15)
    theirs = median_time(lambda: textbook_pass(model, recordings[0], noise), 3)
    print(f"One pass of EM, flexible robot, n = {model.nx}, m = {model.ny}, N = {SAMPLES}; medians")
    print(f"  noiseid, square-root form    {1e3 * ours:8.1f} ms")
    print(f"  textbook form in NumPy       {1e3 * theirs:8.1f} ms")
    print(f"  ratio                        {theirs / ours:8.1f}")


if __name__ == "__main__":
    main()

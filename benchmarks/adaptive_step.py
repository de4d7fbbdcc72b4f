"""Time of one step of the online filters on the two systems of Riva et al. (2017), against their sample time of 0.2 ms.

`noiseid` filters a recording in one compiled loop and, sample by sample, through the Python class that runs beside a
machine; both are timed, as the least processor time over blocks of samples.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import cache, partial

import numpy as np

from noiseid_cli.estimators.adaptive_srukf import AdaptiveFilter, AdaptiveOptions
from noiseid_cli.estimators.joint_srukf import JointFilter, JointOptions
from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.estimators.unknowns import ParameterUnknowns, Unknowns
from noiseid_cli.filters.sigma_points import unscented
from noiseid_cli.filters.srukf import SquareRootUnscentedFilter
from noiseid_cli.models.compile import compile_model
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.equations import Model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording
from noiseid_cli.models.registry import load_model
from noiseid_cli.simulation.motions import SCurveMotion, plan_motion
from noiseid_cli.simulation.simulate import simulate

BLOCK, BLOCKS = 2000, 7
SAMPLE_TIME = 2e-4
CASES = {
    "one_link": {
        "output": "q", "move": 2.0, "start": 0.0, "Q": [1e-11, 5e-5], "R": [5e-7, 5.0], "alpha": 0.08,
        "variances": {"v_q": 5e-13},
        "parameters": {"inverse_inertia": 1e-1, "mu_v": 1e-6, "mu_d": 1e-4, "mal2": 1e-8},
    },
    "pendubot": {
        "output": "q1", "move": 1.5, "start": -np.pi / 2, "Q": [2e-10, 1.5e-7] * 2, "R": [5e-7, 5e-7, 1.0],
        "alpha": 0.85, "variances": {"v_q1": 1e-25, "v_q2": 1e-25},
        "parameters": {"t1": 1e-7, "t2": 1e-7, "t3": 1e-7, "t4": 5e-10, "t5": 1e-10},
    },
}  # fmt: skip


@cache
def problem(name: str) -> tuple[Model, CompiledModel, Recording, NoiseValues]:
    """The model, a simulated recording and the noise values."""
    case = CASES[name]
    model = load_model(name)
    compiled = compile_model(model)
    motion = SCurveMotion("tau", case["output"], (case["start"], case["start"] + 1.0), case["move"], 0.2, 15, 2, 60)
    samples = 2 * BLOCK * BLOCKS
    Q, R = np.diag(case["Q"]), np.diag(case["R"])
    plan = plan_motion("s_curve", motion, model, compiled, samples)
    data = simulate(model, compiled, plan, Q, R, seed=1, samples=samples)
    return model, compiled, data.recordings[0], NoiseValues(Q, R, data.recordings[0].x_true[:1], 1e-4 * np.eye(len(Q)))


def prepare(name: str) -> tuple[Recording, dict[str, object]]:
    """The recording and a fresh filter of each kind, with parameters from their true values."""
    case = CASES[name]
    model, compiled, recording, noise = problem(name)
    names = tuple(case["parameters"])
    free = np.full(len(names), np.inf)
    parameters = ParameterUnknowns(names, np.array([model.values[n] for n in names]), -free, free)
    held = frozenset((i, i) for i, n in enumerate(compiled.noises) if n not in case["variances"])
    unknowns = Unknowns(Q=CovarianceStructure(noise.Q, tuple((i,) for i in range(len(noise.Q))), held=held))
    table = case["variances"] | case["parameters"]

    def adaptive(monitor: bool) -> AdaptiveFilter:
        options = AdaptiveOptions(table, alpha=case["alpha"], monitor=monitor, window=3000)
        return AdaptiveFilter(model, compiled, noise, unknowns, parameters, options)

    joint = JointOptions(case["parameters"], dict.fromkeys(names, 1e-12), case["alpha"])
    return recording, {
        "srukf": SquareRootUnscentedFilter(compiled, noise, unscented(compiled.nx, case["alpha"])),
        "asrukf": adaptive(False),
        "sb-asrukf": adaptive(True),
        "joint-srukf": JointFilter(model, compiled, noise, parameters, joint),
    }


def run_block(filter_: object, recording: Recording, part: slice) -> None:
    """Take in samples at once."""
    dt = np.full(part.stop - part.start, SAMPLE_TIME)
    if isinstance(filter_, AdaptiveFilter):
        filter_.take(recording.y[part], recording.u[part], dt, 1000)
    else:
        getattr(filter_, "online", filter_).take(recording.y[part], recording.u[part], dt)


def run_steps(filter_: object, recording: Recording, part: slice) -> None:
    """Take in samples one by one."""
    for k in range(part.start, part.stop):
        filter_.step(recording.y[k], recording.u[k], SAMPLE_TIME)


def best_step(run: Callable[[slice], None], begin: int) -> float:
    """Least processor time of a step over blocks of samples, s."""
    times = []
    for i in range(BLOCKS):
        began = time.process_time()
        run(slice(begin + i * BLOCK, begin + (i + 1) * BLOCK))
        times.append((time.process_time() - began) / BLOCK)
    return min(times)


def main() -> None:
    """Run all filters on both systems and print the table."""
    print(f"Least time of a step, us, and how often it fits into the sample time of {1e6 * SAMPLE_TIME:.0f} us")
    print(f"{'':24}{'recording':>18}{'sample by sample':>20}")
    for name in CASES:
        recording, filters = prepare(name)
        for label, filter_ in filters.items():
            found = [
                best_step(partial(run_block, filter_, recording), 0),
                best_step(partial(run_steps, filter_, recording), BLOCK * BLOCKS),
            ]
            columns = "".join(f"{1e6 * t:10.1f} ({SAMPLE_TIME / t:5.0f}x)" for t in found)
            print(f"{name + ' ' + label:24}{columns}")


if __name__ == "__main__":
    main()

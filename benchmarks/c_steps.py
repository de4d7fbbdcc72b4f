"""(c) A step of the unscented filters on the pendubot (n 4): against filterpy, and against the sample time."""

from __future__ import annotations

import numpy as np
from adaptive_step import BLOCK, SAMPLE_TIME, prepare, run_block, run_steps
from timing import Work, peer, side_by_side

from noiseid_cli.models.compile import compile_model
from noiseid_cli.models.discretisation import advance, workspace
from noiseid_cli.models.registry import load_model


def filterpy() -> Work:
    """``predict`` and ``update`` of its filter; the equations are noiseid's compiled ones, which spares it time."""
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    model = compile_model(load_model("pendubot"))
    recording, _ = prepare("pendubot")
    work, v = workspace(model.nx, model.nv), np.zeros(model.nv)

    def fx(x: np.ndarray, dt: float, u: np.ndarray) -> np.ndarray:
        after = np.empty(model.nx)
        advance(model.scheme, model.drift, x, u, v, dt, model.parameters, after, work)
        return after

    def hx(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        y = np.empty(model.ny)
        model.output(x, u, model.parameters, y)
        return y

    points = MerweScaledSigmaPoints(model.nx, 0.85, 2.0, 3.0 - model.nx)
    kalman = UnscentedKalmanFilter(model.nx, model.ny, SAMPLE_TIME, hx, fx, points)
    kalman.x, kalman.P = recording.x_true[0].copy(), 1e-4 * np.eye(model.nx)
    kalman.Q, kalman.R = 1e-8 * np.eye(model.nx), np.diag([5e-7, 5e-7, 1.0])[: model.ny, : model.ny]
    steps = iter(range(10**9))

    def run() -> None:
        for _ in range(200):
            k = next(steps) % 4000
            kalman.predict(u=recording.u[k])
            kalman.update(recording.y[k], u=recording.u[k])

    return run


def rows() -> list[list[str]]:
    """Times of one step."""
    recording, filters = prepare("pendubot")
    parts = iter(range(10**9))

    def part(length: int) -> slice:
        first = length * (next(parts) % 4)
        return slice(first, first + length)

    works = {
        "noiseid, recording": lambda: run_block(filters["srukf"], recording, part(BLOCK)),
        "noiseid, sample by sample": lambda: run_steps(filters["srukf"], recording, part(BLOCK)),
        "filterpy": peer(filterpy),
        "noiseid SB-aSRUKF, sample by sample": lambda: run_steps(filters["sb-asrukf"], recording, part(BLOCK)),
    }
    times = side_by_side(works)
    steps = {name: BLOCK if name != "filterpy" else 200 for name in works}
    per = {name: t if isinstance(t, str) else t / steps[name] for name, t in times.items()}
    from timing import compared

    adaptive = per.pop("noiseid SB-aSRUKF, sample by sample")
    return [
        *compared("c. UKF step, pendubot", per),
        *compared("c. SB-aSRUKF step, pendubot", {"noiseid, sample by sample": adaptive, "sample time": SAMPLE_TIME}),
    ]

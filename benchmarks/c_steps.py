"""(c) A step of the unscented filters on the pendubot (n 4): against filterpy, and against the sample time.

filterpy gets the equations as Python functions, which are faster there than noiseid's compiled ones, called from
Python. Its log-likelihood is compared with noiseid's before anything is timed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from adaptive_step import BLOCK, SAMPLE_TIME, prepare, problem, run_block, run_steps
from python_model import plain
from timing import Work, checked, compared, peer, side_by_side

from noiseid_cli.filters.sigma_points import unscented
from noiseid_cli.filters.srukf import square_root_unscented_filter
from noiseid_cli.models.recording import Recording

ALPHA = 0.85
CHECKED, STEPS = 500, 200


def filterpy() -> Work | str:
    """``predict`` and ``update`` of its filter, over the recording again and again."""
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    equations, model, recording, noise = problem("pendubot")
    after, output = plain(equations)
    points = MerweScaledSigmaPoints(model.nx, ALPHA, 2.0, 3.0 - model.nx)
    kalman = UnscentedKalmanFilter(model.nx, model.ny, SAMPLE_TIME, output, lambda x, dt, u: after(x, u), points)
    kalman.x, kalman.P, kalman.Q, kalman.R = noise.m0[0].copy(), noise.P0, noise.Q, noise.R
    kalman.sigmas_f = points.sigma_points(kalman.x, kalman.P)
    kalman.update(recording.y[0], u=recording.u[0])
    loglik = kalman.log_likelihood
    steps = iter(range(1, 10**9))

    def step() -> None:
        k = next(steps) % (4 * BLOCK)
        kalman.predict(u=recording.u[k - 1])
        kalman.update(recording.y[k], u=recording.u[k])

    for _ in range(CHECKED - 1):
        step()
        loglik += kalman.log_likelihood
    part = Recording("checked", recording.dt[: CHECKED - 1], recording.u[:CHECKED], recording.y[:CHECKED])
    ours = square_root_unscented_filter(model, part, noise, unscented(model.nx, ALPHA)).loglik
    return checked(lambda: [step() for _ in range(STEPS)], abs(loglik / ours - 1.0))


def blocks(kind: str, run: Callable[[object, Recording, slice], None]) -> Work:
    """Work that filters one block after the other, with a new filter after the last; the best run is none of those."""

    def endless() -> Iterator[None]:
        while True:
            recording, filters = prepare("pendubot")
            for first in range(0, recording.samples - BLOCK + 1, BLOCK):
                run(filters[kind], recording, slice(first, first + BLOCK))
                yield

    each = endless()
    return lambda: next(each)


def rows() -> list[list[str]]:
    """Times of one step."""
    ours: dict[str, Work | str] = {
        "noiseid, recording": blocks("srukf", run_block),
        "noiseid, sample by sample": blocks("srukf", run_steps),
        "SB-aSRUKF, recording": blocks("sb-asrukf", run_block),
        "SB-aSRUKF, sample by sample": blocks("sb-asrukf", run_steps),
    }
    times = side_by_side(ours | {"filterpy": peer(filterpy)})
    per = {n: t if isinstance(t, str) else t / (BLOCK if n in ours else STEPS) for n, t in times.items()}
    adaptive = {f"noiseid, {n.split(', ')[1]}": per.pop(n) for n in ours if n.startswith("SB")}
    return [
        *compared("c. UKF step, pendubot", per),
        *compared("c. SB-aSRUKF step, pendubot", {**adaptive, "sample time": SAMPLE_TIME}),
    ]

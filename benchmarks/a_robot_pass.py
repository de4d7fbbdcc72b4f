"""(a) One pass of EM on the flexible robot (n 8, m 4): extended Kalman filter, smoother and M-step.

Before anything is timed its log-likelihood, Q and smoothed states are compared with noiseid's: a program that computes
something else has a row that says so, and no time.
"""

from __future__ import annotations

import numpy as np
from jax_peers import Peer, cuthbert, dynamax
from python_model import with_jacobians
from robot import robot_data
from textbook import Answer, Measure, Step, compiled_functions, em_pass
from timing import Work, checked, compared, peer, side_by_side

from noiseid_cli.estimators.em_statistics import e_step
from noiseid_cli.filters.smoother import extended_kalman_smoother, filter_to_smooth
from noiseid_cli.models.registry import load_model

SAMPLES = (2000, 20000)


def noiseid(samples: int) -> tuple[Work, Answer]:
    """The pass, and what it ends with."""
    model, recording, noise = robot_data(samples)
    found = e_step(model, [recording], noise)
    smoothed = extended_kalman_smoother(filter_to_smooth(model, recording, noise))
    answer = Answer(found.loglik, found.moment_v, smoothed.m, smoothed.P)
    return lambda: e_step(model, [recording], noise), answer


def textbook(samples: int, functions: tuple[Step, Measure]) -> Peer:
    """Covariances, inverses, a Python loop."""
    _, recording, noise = robot_data(samples)

    def run() -> Answer:
        return em_pass(*functions, recording, noise)

    return run, run


def furthest(answer: Answer, ours: Answer) -> float:
    """Largest relative difference: of states by their standard deviations, of covariances by those of both."""
    assert ours.P is not None
    sd = np.sqrt(np.einsum("kii->ki", ours.P))
    found = [abs(answer.loglik / ours.loglik - 1.0)]
    if answer.Q is not None:
        found.append(np.abs(answer.Q - ours.Q).max() / np.abs(ours.Q).max())
    if answer.m is not None:
        found += [
            np.abs((answer.m - ours.m) / sd).max(),
            np.abs((answer.P - ours.P) / (sd[:, :, None] * sd[:, None, :])).max(),
        ]
    return float(max(found))


def works_of(samples: int) -> dict[str, Work | str]:
    """All programs whose answer is noiseid's; for the others a sentence."""
    model, recording, _ = robot_data(samples)
    work, ours = noiseid(samples)
    peers = {
        "textbook NumPy": lambda: textbook(samples, with_jacobians(load_model("flexible_robot"))),
        "textbook NumPy, compiled model": lambda: textbook(samples, compiled_functions(model, recording.dt[0])),
        "dynamax, no M-step": lambda: dynamax(samples),
        "cuthbert, no M-step": lambda: cuthbert(samples),
    }
    works: dict[str, Work | str] = {"noiseid": work}
    for name, make in peers.items():
        made = peer(make)
        if not isinstance(made, str):
            run, answer = made
            made = checked(run, furthest(answer(), ours))
        works[name] = made
    return works


def rows() -> list[list[str]]:
    """The comparison for both lengths."""
    out = []
    for samples in SAMPLES:
        out += compared(f"a. EM pass, flexible robot, N = {samples}", side_by_side(works_of(samples)))
    return out

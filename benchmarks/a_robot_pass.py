"""(a) One pass of EM on the flexible robot (n 8, m 4): extended Kalman filter, smoother and M-step.

dynamax and cuthbert have no M-step for nonlinear models: theirs is the filter and the smoother alone, in double
precision, compiled by jax for the CPU, with Q carried to the states by the noise gain at the first sample.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from robot import jax_functions, robot_data
from timing import Work, compared, peer, side_by_side

from noiseid_cli.estimators.em_statistics import e_step

SAMPLES = (2000, 20000)


def textbook(samples: int) -> Work:
    """Covariances, inverses, a Python loop."""
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "oracles"))
    from covariance_form import filter_twin, smoother_twin, step

    model, recording, noise = robot_data(samples)

    def run() -> np.ndarray:
        m, P, lag = smoother_twin(filter_twin(model, recording, noise))
        total = np.zeros((model.nv, model.nv))
        for k in range(recording.samples - 1):
            x_next, J, G = step(model, m[k], recording.u[k], recording.dt[k])
            r = m[k + 1] - x_next
            M = P[k + 1] - lag[k] @ J.T - J @ lag[k].T + J @ P[k] @ J.T + np.outer(r, r)
            left = np.linalg.pinv(G)
            total += left @ M @ left.T
        return total / (recording.samples - 1)

    return run


def state_noise(samples: int) -> np.ndarray:
    """(n, n) covariance of the process noise on the states."""
    from covariance_form import step

    model, recording, noise = robot_data(samples)
    _, _, G = step(model, noise.m0[0], recording.u[0], recording.dt[0])
    covariance: np.ndarray = G @ noise.Q @ G.T
    return covariance


def dynamax(samples: int) -> Work:
    """``extended_kalman_smoother`` under jit."""
    import jax
    from dynamax.nonlinear_gaussian_ssm import ParamsNLGSSM, extended_kalman_smoother

    jax.config.update("jax_enable_x64", True)
    _, recording, noise = robot_data(samples)
    step, measure = jax_functions()
    params = ParamsNLGSSM(noise.m0[0], noise.P0, step, state_noise(samples), measure, noise.R)
    smooth = jax.jit(lambda y, u: extended_kalman_smoother(params, y, inputs=u).smoothed_means)
    y, u = jax.numpy.asarray(recording.y), jax.numpy.asarray(recording.u)
    assert np.isfinite(smooth(y, u)).all()
    return lambda: smooth(y, u).block_until_ready()


def cuthbert(samples: int) -> Work:
    """Filter and smoother linearised at the filtered states, sequential (as its CPU users run it)."""
    import jax
    from cuthbert import filter as run_filter
    from cuthbert import smoother as run_smoother
    from cuthbert.gaussian import moments

    jax.config.update("jax_enable_x64", True)
    _, recording, noise = robot_data(samples)
    step, measure = jax_functions()
    n = len(noise.P0)
    # A generalised factor, since Q has rank 4; the first state is known to P0.
    chol_Q, chol_R, chol_P0 = np.zeros((n, n)), np.sqrt(noise.R), np.sqrt(noise.P0)
    values, vectors = np.linalg.eigh(state_noise(samples))
    chol_Q[:] = vectors * np.sqrt(np.maximum(values, 0.0))

    def dynamics(state, inputs):  # type: ignore[no-untyped-def]
        return lambda x: (step(x, inputs["u_before"]), chol_Q), state.mean

    def observation(state, inputs):  # type: ignore[no-untyped-def]
        return lambda x: (measure(x, inputs["u"]), chol_R), state.mean, inputs["y"]

    filter_ = moments.build_filter(noise.m0[0], chol_P0, dynamics, observation)
    smoother_ = moments.build_smoother(dynamics)

    @jax.jit
    def smooth(y, u):  # type: ignore[no-untyped-def]
        inputs = {"y": y[1:], "u": u[1:], "u_before": u[:-1]}
        states = run_filter(filter_, inputs, filter_.init_prepare())
        return run_smoother(smoother_, states).mean

    y, u = jax.numpy.asarray(recording.y), jax.numpy.asarray(recording.u)
    assert np.isfinite(smooth(y, u)).all()
    return lambda: smooth(y, u).block_until_ready()


def rows() -> list[list[str]]:
    """The comparison for both lengths."""
    out = []
    for samples in SAMPLES:
        model, recording, noise = robot_data(samples)
        works = {
            "noiseid": lambda m=model, r=recording, v=noise: e_step(m, [r], v),
            "textbook NumPy": textbook(samples),
            "dynamax, no M-step": peer(lambda s=samples: dynamax(s)),
            "cuthbert, no M-step": peer(lambda s=samples: cuthbert(s)),
        }
        out += compared(f"a. EM pass, flexible robot, N = {samples}", side_by_side(works))
    return out


if __name__ == "__main__":
    from timing import markdown

    print(markdown(("task", "program", "time", "times noiseid"), rows(), 2))

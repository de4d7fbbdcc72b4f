"""The flexible robot in dynamax and cuthbert, in double precision, compiled by jax for the CPU.

Neither has an M-step for nonlinear models: theirs is the filter and the smoother. Both get the covariance of the noise
on the states, which depends on the state, at noiseid's filtered states and for nothing; then they compute the
log-likelihood that noiseid computes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from robot import jax_functions, robot_data
from textbook import Answer, compiled_functions
from timing import Work

from noiseid_cli.filters.ekf import extended_kalman_filter

Array = np.ndarray
Peer = tuple[Work, Callable[[], Answer]]


def noise_gains(samples: int) -> tuple[Array, Array, Array]:
    """(N-1, n, nv) noise gain at the filtered states, and mean (n,) and factor (n, n) of the first one."""
    model, recording, noise = robot_data(samples)
    filtered = extended_kalman_filter(model, recording, noise)
    step, _ = compiled_functions(model, recording.dt[0])
    gains = np.array([step(filtered.m_filt[k], recording.u[k])[2] for k in range(samples - 1)])
    return gains, filtered.m_filt[0], filtered.U_filt[0].T


def dynamax(samples: int) -> Peer:
    """``extended_kalman_smoother``.

    It adds 1e-9 to the diagonal of every covariance that it divides by, in silence, which is a thousand times the
    variance of an encoder here: it gets states and outputs in units so small that this is nothing. Its inputs and
    noises of a step are counted by the sample that the step leads to.
    """
    import jax
    from dynamax.nonlinear_gaussian_ssm import ParamsNLGSSM, extended_kalman_smoother

    jax.config.update("jax_enable_x64", True)
    jnp = jax.numpy
    _, recording, noise = robot_data(samples)
    step, measure = jax_functions()
    gains, _, _ = noise_gains(samples)
    a, b = 1e3 / np.sqrt(np.diag(noise.P0)), 1e3 / np.sqrt(np.diag(noise.R))
    on_states = a[:, None] * gains @ noise.Q @ (a[:, None] * gains).transpose(0, 2, 1)
    params = ParamsNLGSSM(
        jnp.asarray(a * noise.m0[0]), jnp.asarray(np.outer(a, a) * noise.P0),
        lambda x, u: a * step(x / a, u[:2]), jnp.asarray(np.concatenate((on_states[:1], on_states))),
        lambda x, u: b * measure(x / a, u[2:]), jnp.asarray(np.outer(b, b) * noise.R),
    )  # fmt: skip

    @jax.jit
    def smooth(y, u):  # type: ignore[no-untyped-def]
        found = extended_kalman_smoother(params, y, inputs=u)
        return found.marginal_loglik, found.smoothed_means, found.smoothed_covariances

    u_before = np.concatenate((recording.u[:1], recording.u[:-1]))
    y, u = jnp.asarray(b * recording.y), jnp.asarray(np.hstack((u_before, recording.u)))

    def answer() -> Answer:
        loglik, m, P = smooth(y, u)
        units = recording.samples * np.log(b).sum()
        return Answer(float(loglik) + units, None, np.asarray(m) / a, np.asarray(P) / np.outer(a, a))

    return lambda: jax.block_until_ready(smooth(y, u)), answer


def cuthbert(samples: int) -> Peer:
    """Filter and smoother linearised at the filtered states, sequential (as its CPU users run it).

    Its prior stands before a step, so that it is given the state at the first sample, corrected.
    """
    import jax
    from cuthbert import filter as run_filter
    from cuthbert import smoother as run_smoother
    from cuthbert.gaussian import moments

    jax.config.update("jax_enable_x64", True)
    _, recording, noise = robot_data(samples)
    step, measure = jax_functions()
    gains, m_first, chol_first = noise_gains(samples)
    # Generalised factors: of a noise of rank 4 on 8 states.
    chol_Q = np.concatenate((gains @ np.sqrt(noise.Q), np.zeros_like(gains)), axis=2)
    chol_R = np.sqrt(noise.R)

    def dynamics(state, inputs):  # type: ignore[no-untyped-def]
        return lambda x: (step(x, inputs["u_before"]), inputs["chol_Q"]), state.mean

    def observation(state, inputs):  # type: ignore[no-untyped-def]
        return lambda x: (measure(x, inputs["u"]), chol_R), state.mean, inputs["y"]

    filter_ = moments.build_filter(m_first, chol_first, dynamics, observation)
    smoother_ = moments.build_smoother(dynamics)

    @jax.jit
    def smooth(inputs):  # type: ignore[no-untyped-def]
        states = run_filter(filter_, inputs, filter_.init_prepare())
        smoothed = run_smoother(smoother_, states)
        return states.log_normalizing_constant[-1], smoothed.mean, smoothed.chol_cov

    given: dict[str, Any] = {"y": recording.y[1:], "u": recording.u[1:], "u_before": recording.u[:-1], "chol_Q": chol_Q}
    inputs = {name: jax.numpy.asarray(value) for name, value in given.items()}
    first = _first_loglik(samples)

    def answer() -> Answer:
        loglik, m, chol = map(np.asarray, smooth(inputs))
        return Answer(float(loglik) + first, None, m, chol @ chol.transpose(0, 2, 1))

    return lambda: jax.block_until_ready(smooth(inputs)), answer


def _first_loglik(samples: int) -> float:
    """Log-likelihood of the first sample."""
    model, recording, noise = robot_data(samples)
    y = recording.y.copy()
    y[1:] = np.nan
    return float(extended_kalman_filter(model, replace(recording, y=y), noise).loglik)

"""A small nonlinear model for tests: a damped, driven pendulum with a noisy torque and two sensors."""

import numpy as np
import sympy
from one_step import transition, workspace

from noiseid_cli.models import Model, Parameter, Quantity
from noiseid_cli.models.compile import compile_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording


class Pendulum(Model):
    """A damped pendulum; the accelerometer makes the output nonlinear in the state."""

    name = "test_pendulum"
    states = (Quantity("q", "rad", "angle"), Quantity("w", "rad/s", "speed"))
    inputs = (Quantity("tau", "N m", "torque"),)
    noises = (Quantity("v1", "N m", "torque noise"),)
    outputs = (Quantity("q_meas", "rad", "angle"), Quantity("a_meas", "rad/s^2", "acceleration"))
    parameters = (Parameter("c", 0.3, "1/s", "damping"), Parameter("g", 9.0, "1/s^2", "gravity over length"))
    sample_time = 0.05
    discretisation = "rk4"

    def dynamics(self, x, u, v, p):
        """Newton's law with a gain of the noise that depends on the state."""
        return [x.w, -p.g * sympy.sin(x.q) - p.c * x.w + u.tau + (1 + x.q**2 / 4) * v.v1]

    def output(self, x, u, p):
        """Angle and acceleration without noise."""
        return [x.q, -p.g * sympy.sin(x.q) - p.c * x.w + u.tau]


def pendulum_case(seed, lengths=(40,), missing=0.0, q=0.5, r=(0.03, 0.5)):
    """Compiled model, noise values and simulated recordings; ``missing`` is a share of the second output."""
    model = compile_model(Pendulum())
    rng = np.random.default_rng(seed)
    noise = NoiseValues(
        np.array([[q**2]]), np.diag(np.square(r)), np.tile([0.4, 0.0], (len(lengths), 1)), np.diag([0.01, 0.04])
    )
    recordings = []
    for i, N in enumerate(lengths):
        x = noise.m0[i] + np.sqrt(np.diag(noise.P0)) * rng.normal(size=2)
        u, y = 2 * np.sin(0.2 * np.arange(N))[:, None], np.empty((N, 2))
        dt = 0.05 * rng.uniform(0.5, 1.5, size=N - 1)
        x_next, F, G, work = np.empty(2), np.empty((2, 2)), np.empty((2, 1)), workspace(2, 1)
        for k in range(N):
            model.output(x, u[k], model.parameters, y[k])
            y[k] += np.array(r) * rng.normal(size=2)
            if k < N - 1:
                transition(model.scheme, model.drift_jacobian, x, u[k], dt[k], model.parameters, x_next, F, G, work)
                x = x_next + G[:, 0] * q * rng.normal()
        y[rng.uniform(size=N) < missing, 1] = np.nan
        recordings.append(Recording(f"test-{i}", dt, u, y))
    return model, noise, tuple(recordings)

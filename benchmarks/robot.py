"""The flexible robot as the benchmarks use it: data, noise values, its equations as JAX functions and its twin."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from noiseid_cli.models.compile import compile_model
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording
from noiseid_cli.models.registry import load_model
from noiseid_cli.simulation.motions import Square, plan_motion
from noiseid_cli.simulation.simulate import simulate

Q = np.diag([50.0, 20.0, 30.0, 15.0]) ** 2
R = np.diag([1e-12, 1e-12, 1e-3, 1e-3])
P0 = np.diag([1e-6] * 4 + [1e-3] * 4)


@cache
def robot_data(samples: int) -> tuple[CompiledModel, Recording, NoiseValues]:
    """The compiled robot, one simulated test, and the true noise values."""
    robot = load_model("flexible_robot")
    model = compile_model(robot)
    plan = plan_motion("square", Square(), robot, model, samples)
    recording = simulate(robot, model, plan, Q, R, seed=1, samples=samples).recordings[0]
    assert recording.x_true is not None
    return model, recording, NoiseValues(Q, R, recording.x_true[:1], P0)


def jax_functions() -> tuple[Any, Any]:
    """x_next(x, u) without noise and y(x, u), from the same equations; jax must be installed."""
    import jax.numpy as jnp
    import sympy as sp

    robot = load_model("flexible_robot")
    eq = robot.equations()

    def compiled(expressions: Any) -> Any:
        flat = sp.Matrix(list(expressions))
        for term, definition in reversed(eq.terms.items()):
            flat = flat.subs(term, definition)
        flat = flat.subs(dict.fromkeys(eq.v, 0)).subs(dict(zip(eq.p, robot.vector.tolist(), strict=True)))
        return sp.lambdify([eq.x, eq.u], list(flat), modules="jax", cse=True)

    drift, output = compiled(eq.dynamics), compiled(eq.output)

    def step(x: Any, u: Any) -> Any:
        return x + robot.sample_time * jnp.stack(drift(x, u))

    def measure(x: Any, u: Any) -> Any:
        return jnp.stack(output(x, u))

    return step, measure

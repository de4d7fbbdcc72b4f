"""The starts of an experiment: factors on the start covariances, given or drawn from the seed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from noiseid_cli.pipeline.context import Context

STREAM = 2
"""First entry of the spawn key of the streams that starts are drawn from."""


@dataclass(frozen=True)
class Start:
    """One start of every method.

    Attributes:
        index: its number, from 0.
        label: what it is, for people.
        factors: (nv,) factor on each variance of the process noise's start.
        measurement_factor: factor on the start of the measurement noise.
    """

    index: int
    label: str
    factors: tuple[float, ...]
    measurement_factor: float = 1.0


def starts(context: Context) -> list[Start]:
    """The starts, in order; a drawn one depends on the seed and its own number only, not on how many there are."""
    section = context.experiment.estimate
    assert section is not None
    noises = len(context.model.noises)
    draw = section.starts.draw
    if draw is not None:
        return [
            Start(i, f"drawn {i}", _draw(context.experiment.seed, i, noises, draw.factors.model_dump()))
            for i in range(draw.count)
        ]
    measurement = section.starts.measurement_scale or (1.0,) * len(section.starts.scale)
    return [
        Start(i, f"× {scale:g}", (scale,) * noises, factor)
        for i, (scale, factor) in enumerate(zip(section.starts.scale, measurement, strict=True))
    ]


def _draw(seed: int, index: int, noises: int, options: dict[str, Any]) -> tuple[float, ...]:
    import numpy as np

    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(STREAM, index))))
    if options["kind"] == "log_uniform":
        logs = rng.uniform(np.log(options["lowest"]), np.log(options["highest"]), size=noises)
    else:
        logs = np.log(options["spread"]) * rng.standard_normal(noises)
    return tuple(float(f) for f in np.exp(logs))

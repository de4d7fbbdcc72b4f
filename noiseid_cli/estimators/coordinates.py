"""Everything unknown as one vector of free coordinates, with the gradient of a log-likelihood in them.

Covariances and the initial mean have the coordinates of ``Unknowns``; a model parameter within bounds is mapped to
the whole line, so that no step can leave them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.unknowns import ParameterUnknowns, Unknowns
from noiseid_cli.filters.ekf_adjoint import Gradient
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array


@dataclass(frozen=True)
class Coordinates:
    """Free coordinates z of noise values and model parameters.

    Attributes:
        unknowns: what is unknown of the noise.
        start: noise values; what is known is taken from them.
        model: the model; known parameters are taken from it.
        parameters: the unknown ones of its parameters.
        at: (p,) their places in ``model.parameters``.
    """

    unknowns: Unknowns
    start: NoiseValues
    model: CompiledModel
    parameters: ParameterUnknowns = field(default_factory=ParameterUnknowns)
    at: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        """Refuse parameters that the model does not have, and starts out of bounds."""
        if len(self.at) != len(self.parameters) or any(not 0 <= i < self.model.parameters.size for i in self.at):
            raise EstimationError(
                f"{len(self.parameters)} parameters are unknown and {len(self.at)} places are given among the "
                f"{self.model.parameters.size} of {self.model.name}"
            )
        inside = (self.parameters.lower < self.parameters.start) & (self.parameters.start < self.parameters.upper)
        for name in np.array(self.parameters.names)[~inside]:
            raise EstimationError(f"the start of the parameter {name} is not between its bounds")

    @property
    def has_noise(self) -> bool:
        """Some of Q, R, m0 and P0 is unknown."""
        u = self.unknowns
        return bool(u.Q or u.R or u.P0 or u.m0)

    @property
    def names(self) -> tuple[str, ...]:
        """(d,) what each coordinate is."""
        m, u = self.model, self.unknowns
        out: list[str] = []
        for structure, of in ((u.Q, m.noises), (u.R, m.outputs), (u.P0, m.states)):
            out += structure.names(of) if structure is not None else ()
        out += [f"initial mean of {state}, scaled" for state in m.states] if u.m0 else []
        kinds = {(False, False): "{} scaled", (True, False): "log({} - lower)", (False, True): "-log(upper - {})"}
        for name, lower, upper in zip(self.parameters.names, self.parameters.lower, self.parameters.upper, strict=True):
            out.append(kinds.get((bool(np.isfinite(lower)), bool(np.isfinite(upper))), "logit({})").format(name))
        return tuple(out)

    def pack(self, noise: NoiseValues, parameters: Array) -> Array:
        """(d,) coordinates of noise values and of the model's unknown parameters (p,)."""
        parts = [self.unknowns.pack(noise)] if self.has_noise else []
        return np.concatenate([*parts, self._forward(parameters)])

    def unpack(self, z: Array) -> tuple[NoiseValues, CompiledModel]:
        """Noise values and the model with the parameters at z."""
        split = z.size - len(self.parameters)
        noise = self.unknowns.unpack(z[:split], self.start) if self.has_noise else self.start
        if not self.at:
            return noise, self.model
        return noise, self.model.with_parameters(self.at, self._back(z[split:])[0])

    def values(self, z: Array) -> tuple[Array, Array]:
        """(p,) unknown parameters at z, and (p,) their derivatives by their own coordinates."""
        return self._back(z[z.size - len(self.parameters) :])

    def slope(self, z: Array, gradients: Sequence[Gradient]) -> Array:
        """(d,) derivatives by z of the sum of the tests' log-likelihoods, given those by the natural values."""
        u, parts, done = self.unknowns, [], 0
        for structure, letter in ((u.Q, "Q"), (u.R, "R"), (u.P0, "P0")):
            if structure is not None:
                size = len(structure.coordinate_places)
                total = np.sum([getattr(g, letter) for g in gradients], axis=0)
                parts.append(np.tensordot(structure.jacobian(z[done : done + size]), total, 2))
                done += size
        if u.m0:
            parts.append(np.sum([g.m0 for g in gradients], axis=0) * u.mean_scale(self.start))
        by = np.sum([g.parameters for g in gradients], axis=0)[list(self.at)]
        return np.concatenate([*parts, by * self.values(z)[1]])

    @property
    def _unit(self) -> Array:
        """(p,) unit of a parameter without bounds: the size of its start."""
        size = np.abs(self.parameters.start)
        return np.where(size > 0.0, size, 1.0)

    def _forward(self, value: Array) -> Array:
        lower, upper = self.parameters.lower, self.parameters.upper
        with np.errstate(divide="ignore", invalid="ignore"):
            below = np.where(np.isfinite(lower), np.log(value - lower), 0.0)
            above = np.where(np.isfinite(upper), np.log(upper - value), 0.0)
        free = np.isinf(lower) & np.isinf(upper)
        return np.where(free, value / self._unit, below - above)

    def _back(self, z: Array) -> tuple[Array, Array]:
        """Values and their derivatives by z."""
        value, by = np.empty(z.size), np.empty(z.size)
        bounds = zip(self.parameters.lower, self.parameters.upper, self._unit, strict=True)
        for i, (lower, upper, unit) in enumerate(bounds):
            if np.isinf(lower) and np.isinf(upper):
                value[i], by[i] = unit * z[i], unit
            elif np.isinf(upper):
                value[i], by[i] = lower + np.exp(z[i]), np.exp(z[i])
            elif np.isinf(lower):
                value[i], by[i] = upper - np.exp(-z[i]), np.exp(-z[i])
            else:
                share = 1.0 / (1.0 + np.exp(-z[i]))
                value[i], by[i] = lower + (upper - lower) * share, (upper - lower) * share * (1.0 - share)
        return value, by

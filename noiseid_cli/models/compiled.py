"""A model as the kernels see it: sizes, parameter values and compiled functions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from noiseid_cli.models.recording import Array


@dataclass(frozen=True)
class Adjoints:
    """Reverse derivatives of a model's Jacobian functions, see ``ADJOINT`` in ``models.signatures``.

    Attributes:
        drift: adjoint of ``drift_jacobian``.
        output: adjoint of ``output_jacobian``.
    """

    drift: Callable[..., Any]
    output: Callable[..., Any]


@dataclass(frozen=True)
class CompiledModel:
    """Compiled functions of one model at fixed parameter values.

    Attributes:
        name: name of the model.
        states, inputs, noises, outputs, performances: names, in the order of the vectors x, u, v, y, z.
        units: unit of each of those names.
        parameters: (np,) parameter values p, in the order of the model's declaration.
        scheme: discretisation, one of the constants in ``models.discretisation``.
        drift, drift_jacobian, output, output_jacobian: see ``models.signatures``.
        performance, performance_jacobian: like output and output_jacobian; None where the model has none.
        load_adjoints: gives the adjoints, which are compiled when they are first asked for; None where there are none.
    """

    name: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    noises: tuple[str, ...]
    outputs: tuple[str, ...]
    performances: tuple[str, ...]
    units: dict[str, str]
    parameters: Array
    scheme: int
    drift: Callable[..., Any]
    drift_jacobian: Callable[..., Any]
    output: Callable[..., Any]
    output_jacobian: Callable[..., Any]
    performance: Callable[..., Any] | None
    performance_jacobian: Callable[..., Any] | None
    load_adjoints: Callable[[], Adjoints] | None = None

    def with_parameters(self, places: Sequence[int], values: Array) -> CompiledModel:
        """The same functions with the parameters at ``places`` at other values."""
        p = self.parameters.copy()
        p[list(places)] = values
        return replace(self, parameters=p)

    @property
    def nx(self) -> int:
        """Number of states."""
        return len(self.states)

    @property
    def nu(self) -> int:
        """Number of inputs."""
        return len(self.inputs)

    @property
    def nv(self) -> int:
        """Number of process noises."""
        return len(self.noises)

    @property
    def ny(self) -> int:
        """Number of outputs."""
        return len(self.outputs)

    @property
    def nz(self) -> int:
        """Number of performance outputs."""
        return len(self.performances)

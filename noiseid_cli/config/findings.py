"""What a check of an experiment against its model knows and collects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from noiseid_cli.config.document import Path
from noiseid_cli.config.load import LoadedExperiment
from noiseid_cli.config.suggest import counted, did_you_mean
from noiseid_cli.errors import Problem

FREE = "states with a free first value"
"""What the entries of a law of the first state belong to."""


@dataclass(frozen=True)
class ModelNames:
    """What the check needs to know of a model.

    Attributes:
        states, inputs, noises, outputs, parameters: names, in the order of the model's vectors.
        sample_time: the model's own interval between samples, s; None where it has none.
        discretisation: the model's own, one of discrete, euler, rk4, exact; None where that is not known.
        nonlinearity: why its dynamics are not linear, in words; empty where they are, or where nobody asks.
        free: the states whose first value the model itself says nothing of; None for all.
        sample_time_parameter: the parameter that equals the sample time; empty where there is none.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    noises: tuple[str, ...]
    outputs: tuple[str, ...]
    parameters: tuple[str, ...] = ()
    sample_time: float | None = None
    discretisation: str | None = None
    nonlinearity: str = ""
    sample_time_parameter: str = ""
    free: tuple[str, ...] | None = None

    @property
    def first(self) -> tuple[str, ...]:
        """Names of the states whose first value has a law that the experiment gives."""
        return self.states if self.free is None else self.free


@dataclass
class Findings:
    """Collects problems, each with its place."""

    loaded: LoadedExperiment
    problems: list[Problem] = field(default_factory=list)

    def add(self, path: Path, message: str) -> None:
        """Note a problem with the setting at a path."""
        self.problems.append(self.loaded.problem(path, message))

    def unknown(self, path: Path, name: str, known: Sequence[str], what: str) -> None:
        """Note a name that the model does not have."""
        names = ", ".join(known) or "none"
        self.add(path, f"{name} is not one of the model's {what}: {names}{did_you_mean(name, known)}")


def check_length(
    findings: Findings, path: Path, numbers: Sequence[float] | None, names: Sequence[str], what: str
) -> None:
    """Compare the length of a list with the names it belongs to."""
    if numbers is not None and len(numbers) != len(names):
        has, wanted = counted(len(numbers), "numbers"), counted(len(names), what)
        findings.add(path, f"has {has}, but the model has {wanted}: {', '.join(names)}")

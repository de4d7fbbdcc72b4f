"""Does an experiment fit its model? Lengths, names and what can be estimated at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from noiseid_cli.config.check_noise import check_choice, check_size, check_unit
from noiseid_cli.config.document import Path
from noiseid_cli.config.load import LoadedExperiment
from noiseid_cli.config.schema_estimate import Estimate, MeanChoice
from noiseid_cli.config.schema_import import Import
from noiseid_cli.config.schema_simulate import Multisine, Simulate, Square, Steps, Zero
from noiseid_cli.config.suggest import did_you_mean
from noiseid_cli.errors import Problem

MEMORY_LIMIT_GIB = 1.0
"""Largest size of the true states of one simulated dataset."""


@dataclass(frozen=True)
class ModelNames:
    """What the check needs to know of a model.

    Attributes:
        states, inputs, noises, outputs, parameters: names, in the order of the model's vectors.
        sample_time: the model's own interval between samples, s; None where it has none.
        discretisation: the model's own, one of discrete, euler, rk4, exact; None where that is not known.
        nonlinearity: why its dynamics are not linear, in words; empty where they are, or where nobody asks.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    noises: tuple[str, ...]
    outputs: tuple[str, ...]
    parameters: tuple[str, ...] = ()
    sample_time: float | None = None
    discretisation: str | None = None
    nonlinearity: str = ""


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


def check_against(loaded: LoadedExperiment, model: ModelNames) -> list[Problem]:
    """Compare an experiment with the model that it names.

    Args:
        loaded: the experiment.
        model: names and sample time of the model.

    Returns:
        All problems, ready for a ``ConfigError``; empty where the experiment fits.
    """
    findings = Findings(loaded)
    experiment = loaded.experiment
    _check_model(findings, model)
    if experiment.simulate is not None:
        _check_simulate(findings, experiment.simulate, model)
    if experiment.import_ is not None:
        _check_import(findings, experiment.import_, model)
    if experiment.estimate is not None:
        _check_estimate(findings, experiment.estimate, model)
    return findings.problems


def _check_model(findings: Findings, model: ModelNames) -> None:
    chosen = findings.loaded.experiment.model
    for name in chosen.parameters:
        if name not in model.parameters:
            findings.unknown(("model", "parameters", name), name, model.parameters, "parameters")
    if (
        chosen.discretisation is not None
        and model.discretisation is not None
        and (chosen.discretisation == "discrete") != (model.discretisation == "discrete")
    ):
        kind = "give the next state" if model.discretisation == "discrete" else "are differential equations"
        allowed = "discrete" if model.discretisation == "discrete" else "euler, rk4 or exact"
        findings.add(
            ("model", "discretisation"),
            f"the model's equations {kind}: only {allowed} fits, not {chosen.discretisation}",
        )
    elif chosen.discretisation == "exact" and model.nonlinearity:
        findings.add(
            ("model", "discretisation"), f"exact is for linear dynamics only; {model.nonlinearity}: take rk4 or euler"
        )


def _check_simulate(findings: Findings, simulate: Simulate, model: ModelNames) -> None:
    check_size(findings.add, ("simulate", "process_noise"), simulate.process_noise, model.noises, "process noises")
    check_unit(findings.add, ("simulate", "process_noise"), simulate.process_noise, model.discretisation)
    check_size(findings.add, ("simulate", "measurement_noise"), simulate.measurement_noise, model.outputs, "outputs")
    _check_length(findings, ("simulate", "initial_state"), simulate.initial_state, model.states, "states")
    size = simulate.samples * len(model.states) * simulate.tests * 8 / 2**30
    if size > MEMORY_LIMIT_GIB:
        findings.add(
            ("simulate", "samples"),
            f"{simulate.samples} samples x {simulate.tests} tests x {len(model.states)} states need {size:.3g} GiB; "
            f"at most {MEMORY_LIMIT_GIB:g} GiB are allowed: take fewer samples or tests",
        )
    interval = simulate.sample_time or model.sample_time
    if interval is None:
        findings.add(("simulate", "sample_time"), "is missing: the model has no sample time of its own; give it in s")
        return
    _check_trajectory(findings, ("simulate", "trajectory"), simulate.trajectory, model, interval)
    if simulate.held_out is not None:
        path = ("simulate", "held_out", "trajectory")
        _check_trajectory(findings, path, simulate.held_out.trajectory, model, interval)


def _check_trajectory(
    findings: Findings,
    path: Path,
    trajectory: Square | Zero | Multisine | Steps,
    model: ModelNames,
    interval: float,
) -> None:
    if isinstance(trajectory, Square):
        if findings.loaded.experiment.model.name != "flexible_robot":
            findings.add((*path, "kind"), "square is a motion of flexible_robot only: take zero, multisine or steps")
        _check_time(findings, (*path, "side_time"), trajectory.side_time, interval)
    if isinstance(trajectory, Multisine | Steps):
        _check_length(findings, (*path, "amplitude"), trajectory.amplitude, model.inputs, "inputs")
    if isinstance(trajectory, Multisine) and trajectory.highest >= 0.5 / interval:
        findings.add(
            (*path, "highest"),
            f"{trajectory.highest:g} Hz must be below half the sampling frequency, {0.5 / interval:g} Hz",
        )
    if isinstance(trajectory, Steps):
        _check_time(findings, (*path, "hold"), trajectory.hold, interval)


def _check_time(findings: Findings, path: Path, time: float, interval: float) -> None:
    if time < interval:
        findings.add(path, f"{time:g} s must be at least the sample time, {interval:g} s")


def _check_length(
    findings: Findings, path: Path, numbers: Sequence[float] | None, names: Sequence[str], what: str
) -> None:
    if numbers is not None and len(numbers) != len(names):
        findings.add(path, f"has {len(numbers)} numbers, but the model has {len(names)} {what}: {', '.join(names)}")


def _check_import(findings: Findings, section: Import, model: ModelNames) -> None:
    for kind, wanted in (("inputs", model.inputs), ("outputs", model.outputs)):
        common = getattr(section, kind)
        owns = {recording: getattr(source, kind) for recording, source in section.recordings.items()}
        for name in common:
            if name not in wanted:
                findings.unknown(("import", kind, name), name, wanted, kind)
        for recording, own in owns.items():
            for name in own:
                if name not in wanted:
                    findings.unknown(("import", "recordings", recording, kind, name), name, wanted, kind)
        for name in wanted:
            lacking = [recording for recording, own in owns.items() if name not in own and name not in common]
            if len(lacking) == len(owns):
                findings.add(("import", kind), f"{name} is missing: which column is it?")
                continue
            for recording in lacking:
                findings.add(("import", "recordings", recording, kind), f"{name} is missing: which column is it?")


def _check_estimate(findings: Findings, estimate: Estimate, model: ModelNames) -> None:
    noises = (
        ("process_noise", model.noises, "process noises"),
        ("measurement_noise", model.outputs, "outputs"),
        ("initial_covariance", model.states, "states"),
    )
    for name, names, what in noises:
        check_choice(findings.add, ("estimate", name), getattr(estimate, name), names, what)
    for name in ("known", "start"):
        path = ("estimate", "process_noise", name)
        check_unit(findings.add, path, getattr(estimate.process_noise, name), model.discretisation)
    _check_mean(findings, estimate.initial_mean, model)
    for name in estimate.parameters:
        if name not in model.parameters:
            findings.unknown(("estimate", "parameters", name), name, model.parameters, "parameters")
    choices = [getattr(estimate, name) for name, _, _ in noises]
    if not estimate.parameters and all(choice.start is None for choice in [*choices, estimate.initial_mean]):
        findings.add(("estimate",), "nothing is left to estimate: all is known; give a start in place of a known")
    if estimate.process_noise.start is None and set(estimate.starts.scale) != {1.0}:
        findings.add(("estimate", "starts", "scale"), "scales the start of process_noise, which is known here")
    if estimate.measurement_noise.start is None and estimate.starts.measurement_scale is not None:
        findings.add(
            ("estimate", "starts", "measurement_scale"),
            "scales the start of measurement_noise, which is known here",
        )
    if estimate.initial_covariance.start is not None and not _several_tests(findings.loaded):
        findings.add(
            ("estimate", "initial_covariance", "start"),
            "needs at least two tests: the spread of the first state cannot be seen in one; give known",
        )


def _several_tests(loaded: LoadedExperiment) -> bool:
    """Say whether a dataset has, or may come to have, more than one test."""
    simulate, section = loaded.experiment.simulate, loaded.experiment.import_
    if simulate is not None:
        return simulate.tests > 1
    assert section is not None  # the schema asks for one of the two
    return section.on_problem.gap == "split" or (section.group == "together" and len(section.recordings) > 1)


def _check_mean(findings: Findings, choice: MeanChoice, model: ModelNames) -> None:
    name = "known" if choice.known is not None else "start"
    path: Path = ("estimate", "initial_mean", name)
    mean = getattr(choice, name)
    section = findings.loaded.experiment.import_
    if mean == "truth":
        if section is not None:
            findings.add(path, "the truth is known for simulated tests only: give a list of numbers")
    elif not isinstance(mean, dict):
        _check_length(findings, path, mean, model.states, "states")
    elif section is None:
        findings.add(path, "a list for each test goes with import: give truth or one list for all tests")
    else:
        for test, numbers in mean.items():
            if test not in section.recordings:
                known = list(section.recordings)
                findings.add((*path, test), f"is not a recording: {', '.join(known)}{did_you_mean(test, known)}")
            _check_length(findings, (*path, test), numbers, model.states, "states")
        if lacking := [recording for recording in section.recordings if recording not in mean]:
            findings.add(path, f"has no list for {', '.join(lacking)}")

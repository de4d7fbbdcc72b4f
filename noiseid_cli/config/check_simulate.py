"""Does the ``simulate`` section fit the model: noise, motion, first state, changes of parameters?"""

from __future__ import annotations

from noiseid_cli.config.check_noise import check_size, check_unit
from noiseid_cli.config.document import Path
from noiseid_cli.config.findings import FREE, Findings, ModelNames, check_length
from noiseid_cli.config.schema_simulate import Multisine, SCurve, Simulate, Square, Steps, Trajectory


def check_simulate(findings: Findings, simulate: Simulate, model: ModelNames) -> None:
    """Note every problem with the section."""
    check_size(findings.add, ("simulate", "process_noise"), simulate.process_noise, model.noises, "process noises")
    check_unit(findings.add, ("simulate", "process_noise"), simulate.process_noise, model.discretisation)
    check_size(findings.add, ("simulate", "measurement_noise"), simulate.measurement_noise, model.outputs, "outputs")
    check_length(findings, ("simulate", "initial_state"), simulate.initial_state, model.first, FREE)
    if simulate.initial_covariance is not None:
        path: Path = ("simulate", "initial_covariance")
        check_size(findings.add, path, simulate.initial_covariance, model.first, FREE)
    interval = simulate.sample_time or model.sample_time
    if interval is None:
        findings.add(("simulate", "sample_time"), "is missing: the model has no sample time of its own; give it in s")
        return
    _check_sample_time(findings, simulate, model)
    _check_changes(findings, simulate, model, interval)
    _check_trajectory(findings, ("simulate", "trajectory"), simulate.trajectory, model, interval)
    if simulate.held_out is not None:
        path = ("simulate", "held_out", "trajectory")
        _check_trajectory(findings, path, simulate.held_out.trajectory, model, interval)


def _check_sample_time(findings: Findings, simulate: Simulate, model: ModelNames) -> None:
    """A sample time may be given in two places, which must agree."""
    name = model.sample_time_parameter
    given = findings.loaded.experiment.model.parameters.get(name)
    if given is not None and simulate.sample_time is not None and given != simulate.sample_time:
        findings.add(
            ("model", "parameters", name),
            f"equals the sample time, which simulate.sample_time gives as {simulate.sample_time:g} s: leave one out",
        )


def _check_changes(findings: Findings, simulate: Simulate, model: ModelNames, interval: float) -> None:
    last = (simulate.samples - 1) * interval
    for i, change in enumerate(simulate.parameter_changes):
        path: Path = ("simulate", "parameter_changes", i)
        if change.at > last:
            findings.add((*path, "at"), f"{change.at:g} s is after the last sample, at {last:g} s")
        for kind in ("set", "scale"):
            for name in getattr(change, kind):
                if name not in model.parameters:
                    findings.unknown((*path, kind, name), name, model.parameters, "parameters")
                elif name == model.sample_time_parameter:
                    findings.add((*path, kind, name), "equals the sample time, which cannot change during a test")


def _check_trajectory(
    findings: Findings, path: Path, trajectory: Trajectory, model: ModelNames, interval: float
) -> None:
    if isinstance(trajectory, Square):
        if findings.loaded.experiment.model.name != "flexible_robot":
            findings.add(
                (*path, "kind"), "square is a motion of flexible_robot only: take zero, multisine, steps or s_curve"
            )
        _check_time(findings, (*path, "side_time"), trajectory.side_time, interval)
    if isinstance(trajectory, Multisine | Steps):
        check_length(findings, (*path, "amplitude"), trajectory.amplitude, model.inputs, "inputs")
    if isinstance(trajectory, Multisine):
        _check_frequency(findings, (*path, "highest"), trajectory.highest, interval)
    if isinstance(trajectory, Steps):
        _check_time(findings, (*path, "hold"), trajectory.hold, interval)
    if isinstance(trajectory, SCurve):
        for what, name, names in (
            ("input", trajectory.input, model.inputs),
            ("output", trajectory.output, model.outputs),
        ):
            if name not in names:
                findings.unknown((*path, what), name, names, f"{what}s")
        _check_time(findings, (*path, "move_time"), trajectory.move_time, interval)
        _check_frequency(findings, (*path, "cutoff"), trajectory.cutoff, interval)


def _check_time(findings: Findings, path: Path, time: float, interval: float) -> None:
    if time < interval:
        findings.add(path, f"{time:g} s must be at least the sample time, {interval:g} s")


def _check_frequency(findings: Findings, path: Path, frequency: float, interval: float) -> None:
    if frequency >= 0.5 / interval:
        findings.add(path, f"{frequency:g} Hz must be below half the sampling frequency, {0.5 / interval:g} Hz")

"""Does an experiment fit its model? Lengths, names and what can be estimated at all."""

from __future__ import annotations

from collections.abc import Sequence

from noiseid_cli.config.check_ensemble import check_ensemble
from noiseid_cli.config.check_methods import refusal
from noiseid_cli.config.check_noise import check_choice, check_known, check_unit
from noiseid_cli.config.check_online import check_online
from noiseid_cli.config.check_simulate import check_simulate
from noiseid_cli.config.document import Path
from noiseid_cli.config.findings import FREE, Findings, ModelNames, check_length
from noiseid_cli.config.load import LoadedExperiment
from noiseid_cli.config.schema_estimate import Estimate
from noiseid_cli.config.schema_import import Import
from noiseid_cli.config.schema_unknowns import MeanChoice
from noiseid_cli.config.suggest import did_you_mean
from noiseid_cli.errors import Problem


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
        check_simulate(findings, experiment.simulate, model)
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
    elif chosen.discretisation in ("exact", "van_loan") and model.nonlinearity:
        findings.add(
            ("model", "discretisation"),
            f"{chosen.discretisation} is for linear dynamics only; {model.nonlinearity}: take rk4 or euler",
        )


def _check_import(findings: Findings, section: Import, model: ModelNames) -> None:
    for kind, wanted in (("inputs", model.inputs), ("outputs", model.outputs)):
        common = getattr(section, kind)
        owns = {recording: dict(getattr(source, kind)) for recording, source in section.recordings.items()}
        if kind == "outputs":
            for recording, source in section.recordings.items():
                for i, other in enumerate(source.also):
                    for name in other.outputs:
                        if name not in wanted:
                            path = ("import", "recordings", recording, "also", i, kind, name)
                            findings.unknown(path, name, wanted, kind)
                        owns[recording].setdefault(name, other.outputs[name])
        for name in common:
            if name not in wanted:
                findings.unknown(("import", kind, name), name, wanted, kind)
        for recording, source in section.recordings.items():
            for name in getattr(source, kind):
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
    first = model.first if estimate.initial_map is None else estimate.initial_map.names
    noises = (
        ("process_noise", model.noises, "process noises"),
        ("measurement_noise", model.outputs, "outputs"),
        ("initial_covariance", first, FREE),
    )
    for name, names, what in noises:
        check_choice(findings.add, ("estimate", name), getattr(estimate, name), names, what)
    for name in ("known", "start"):
        path = ("estimate", "process_noise", name)
        check_unit(findings.add, path, getattr(estimate.process_noise, name), model.discretisation)
    if estimate.tuning is not None:
        for name, names, what in noises[:2]:
            check_known(findings.add, ("estimate", "tuning", name), getattr(estimate.tuning, name), names, what)
    _check_mean(findings, estimate.initial_mean, first)
    check_ensemble(findings.add, estimate, model.states, model.outputs)
    for name in estimate.parameters:
        if name not in model.parameters:
            findings.unknown(("estimate", "parameters", name), name, model.parameters, "parameters")
    for label, options in estimate.methods.items():
        if why := refusal(options, estimate):
            findings.add(("estimate", "methods", label), why)
    check_online(findings, estimate, model.noises)
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


def _check_mean(findings: Findings, choice: MeanChoice, first: Sequence[str]) -> None:
    name = "known" if choice.known is not None else "start"
    path: Path = ("estimate", "initial_mean", name)
    mean = getattr(choice, name)
    section = findings.loaded.experiment.import_
    if mean == "truth":
        if section is not None:
            findings.add(path, "the truth is known for simulated tests only: give a list of numbers")
    elif not isinstance(mean, dict):
        check_length(findings, path, mean, first, FREE)
    elif section is None:
        findings.add(path, "a list for each test goes with import: give truth or one list for all tests")
    else:
        for test, numbers in mean.items():
            if test not in section.recordings:
                known = list(section.recordings)
                findings.add((*path, test), f"is not a recording: {', '.join(known)}{did_you_mean(test, known)}")
            check_length(findings, (*path, test), numbers, first, FREE)
        if lacking := [recording for recording in section.recordings if recording not in mean]:
            findings.add(path, f"has no list for {', '.join(lacking)}")

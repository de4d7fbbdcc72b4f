"""An experiment that has been read, with its model, and where its files go."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from noiseid_cli.config.load import MAX_PROBLEMS, LoadedExperiment, first_problems, load_experiment
from noiseid_cli.config.sweep import SweepPoint, at_point, load_point, sweep_points
from noiseid_cli.errors import ConfigError, Problem

if TYPE_CHECKING:
    from noiseid_cli.config.schema import Experiment
    from noiseid_cli.config.schema_model import MarkovNoise
    from noiseid_cli.models.compiled import CompiledModel
    from noiseid_cli.models.equations import Model

Say = Callable[[str], None]
"""Takes a sentence about what is going on."""


@dataclass
class Context:
    """Everything that the stages share.

    Attributes:
        loaded: the checked experiment.
        root: folder that holds the folders of all experiments.
        say: takes sentences such as the one about a first compilation.
        overrides, seed: what was laid over the file, so that a worker process can open it likewise.
        base: of a point of a sweep, the experiment that sweeps.
    """

    loaded: LoadedExperiment
    root: Path
    say: Say
    overrides: tuple[str, ...] = ()
    seed: int | None = None
    base: Context | None = None

    @property
    def experiment(self) -> Experiment:
        """The settings."""
        return self.loaded.experiment

    @property
    def folder(self) -> Path:
        """Where everything of this experiment lands."""
        return self.root / self.experiment.experiment

    @cached_property
    def points(self) -> list[SweepPoint]:
        """The points of the sweep; none where the experiment has no sweep."""
        return sweep_points(self.loaded)

    @cached_property
    def _at(self) -> dict[int, Context]:
        return {}

    def at(self, point: int | None) -> Context:
        """The experiment at a point of its sweep, by number; the experiment itself for None.

        Raises:
            ConfigError: the values of the point do not fit.
        """
        if point is None:
            return self
        if point not in self._at:
            loaded = load_point(self.loaded, self.points[point])
            self._at[point] = Context(loaded, self.root, self.say, self.overrides, self.seed, self)
        return self._at[point]

    @cached_property
    def file_digests(self) -> dict[Path, str]:
        """SHA-256 of recordings that were read already; the points of a sweep share them."""
        return {} if self.base is None else self.base.file_digests

    @cached_property
    def _twin(self) -> Context | None:
        """The experiment that sweeps, where its model is the same to the last value."""
        if self.base is None:
            return None
        (mine, my_interval), (other, interval) = (
            (c.experiment.model, c.experiment.simulate and c.experiment.simulate.sample_time) for c in (self, self.base)
        )
        return self.base if mine == other and my_interval == interval else None

    @cached_property
    def model(self) -> Model:
        """The model with its parameters and discretisation."""
        if self._twin is not None:
            return self._twin.model
        from noiseid_cli.pipeline.model_choice import chosen_model

        choice = self.experiment.model
        model = chosen_model(self.loaded)
        # The class states its own; an instance may differ.
        if choice.discretisation is not None:
            model.discretisation = choice.discretisation  # type: ignore[misc]
        if self.experiment.simulate is not None and self.experiment.simulate.sample_time is not None:
            model.set_sample_time(self.experiment.simulate.sample_time)
        return model if choice.markov_noise is None else self._coloured(model, choice.markov_noise)

    def _coloured(self, model: Model, markov: MarkovNoise) -> Model:
        """The model with Markov processes among its noises.

        Raises:
            ConfigError: a noise is named that the model does not have.
        """
        from noiseid_cli.models.coloured import with_markov_noise
        from noiseid_cli.models.declarations import unknown_name

        names = [q.name for q in model.noises]
        problems = [
            self.loaded.problem(("model", "markov_noise", "on", i), unknown_name(f"process noise {name}", name, names))
            for i, name in enumerate(markov.on)
            if name not in names
        ]
        if problems:
            raise ConfigError(str(self.loaded.file), problems)
        return with_markov_noise(model, markov.time_constants, markov.keep_white)

    @cached_property
    def simulator(self) -> CompiledModel:
        """The model's compiled functions, with a process noise per sample."""
        if self._twin is not None:
            return self._twin.simulator
        from noiseid_cli.models.compile import compile_model

        return compile_model(self.model, self.say)

    @property
    def density(self) -> bool:
        """Estimation takes the covariance of the process noise as a density."""
        section = self.experiment.estimate
        return section is not None and section.process_noise.density

    @property
    def compiled(self) -> CompiledModel:
        """The same as estimation takes it: where ``process_noise`` is a density, the covariance of its noise is one."""
        from noiseid_cli.models.schemes import DENSITY

        model = self.simulator
        return replace(model, scheme=model.scheme + DENSITY) if self.density else model

    @cached_property
    def model_digest(self) -> str:
        """Key of the model's equations and parameter values: another model makes other results."""
        if self._twin is not None:
            return self._twin.model_digest
        from noiseid_cli.models.compile import model_key

        model = self.model
        known = {name: hashlib.sha256(values.tobytes()).hexdigest() for name, values in model.known_inputs.items()}
        parts = [model_key(model), model.values, model.discretisation, model.sample_time]
        # Left out where there is none, as it always was.
        text = json.dumps([*parts, known] if known else parts)
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def fingerprint(self) -> str:
        """Key of all settings and of the model: two contexts with the same one make the same files."""
        text = json.dumps([self.loaded.resolved(), self.model_digest], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def check(self) -> None:
        """Compare the experiment, at every point of its sweep, with its model, and read the published figures.

        Raises:
            ConfigError: with every problem found.
            DataError: the file of published figures cannot be read.
        """
        from noiseid_cli.config.published import load_published

        problems = {problem: problem for problem in self._problems()}
        for point in self.points:
            try:
                found = self.at(point.index)._problems()
            except ConfigError as error:
                found = error.problems
            for problem in found:  # each is told once, with the first point that has it
                problems.setdefault(problem, at_point(problem, point))
            if len(problems) > MAX_PROBLEMS:
                break
        if problems:
            raise ConfigError(str(self.loaded.file), first_problems(list(problems.values())))
        if self.experiment.report.published is not None:
            # Found out now, and not when all units have run.
            load_published(self.loaded.resolve(self.experiment.report.published))

    def _problems(self) -> list[Problem]:
        """What does not fit between the experiment and its model."""
        from noiseid_cli.config.check import check_against
        from noiseid_cli.config.findings import ModelNames

        model = self.model
        groups = (model.states, model.driven_inputs, model.noises, model.outputs, model.parameters)
        states, inputs, noises, outputs, parameters = (tuple(q.name for q in group) for group in groups)
        names = ModelNames(
            states,
            inputs,
            noises,
            outputs,
            parameters,
            sample_time=model.sample_time or None,
            discretisation=type(model).discretisation,
            nonlinearity=self._nonlinearity(model),
            sample_time_parameter=model.sample_time_parameter,
            free=tuple(q.name for q in model.free_first_states),
        )
        return check_against(self.loaded, names)

    def _nonlinearity(self, model: Model) -> str:
        """Why the model cannot be discretised exactly, where the experiment asks for it; empty if it can."""
        from noiseid_cli.models.linearity import nonlinearity

        own, chosen = type(model).discretisation, self.experiment.model.discretisation
        if chosen not in ("exact", "van_loan") or own in ("exact", "van_loan", "discrete"):
            return ""
        # Asked as the class's own scheme: with theirs in force the equations would refuse themselves, without a place.
        model.discretisation = own  # type: ignore[misc]
        try:
            return nonlinearity(model.equations())
        finally:
            model.discretisation = chosen  # type: ignore[misc]


def open_experiment(
    file: Path, root: Path, overrides: Iterable[str] = (), seed: int | None = None, say: Say = lambda _: None
) -> Context:
    """Read an experiment, load its model and compare the two.

    Args:
        file: the experiment file.
        root: folder for the results of all experiments.
        overrides: settings as ``a.b=VALUE``.
        seed: replaces the file's.
        say: takes sentences about what is going on.

    Raises:
        ConfigError, DataError, ModelError: with every problem that could be found.
    """
    overrides = tuple(overrides)
    context = Context(load_experiment(file, overrides, seed), root, say, overrides, seed)
    context.check()
    return context

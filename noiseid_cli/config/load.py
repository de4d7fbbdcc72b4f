"""From an experiment file to a checked experiment, or to every complaint about it at once."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any, NamedTuple

from noiseid_cli.config import overrides as settings
from noiseid_cli.config.document import Document, Path, Place
from noiseid_cli.config.yaml_loader import read_yaml
from noiseid_cli.errors import ConfigError, Problem

if TYPE_CHECKING:
    from noiseid_cli.config.schema import Experiment

MAX_PROBLEMS = 50


@dataclass(frozen=True)
class LoadedExperiment:
    """A checked experiment and where it came from.

    Attributes:
        experiment: the settings, every default filled in.
        file: the file it was read from.
        document: the text and the place of each setting in it.
    """

    experiment: Experiment
    file: FilePath
    document: Document

    @property
    def folder(self) -> FilePath:
        """Folder of the file: where relative paths in it start."""
        return self.file.parent

    @property
    def text(self) -> str:
        """The text of the file, without overrides."""
        return self.document.text

    @property
    def positions(self) -> Mapping[Path, Place]:
        """Line and column of each setting that stands in the file."""
        return self.document.places

    def resolve(self, path: str) -> FilePath:
        """Give the full path of a file that is named in the experiment."""
        return (self.folder / path).resolve()

    def problem(self, path: Path, message: str) -> Problem:
        """Complain about a setting, with its place in the file or the override that it came from."""
        return self.document.problem(path, message)

    def resolved(self) -> dict[str, Any]:
        """Give the settings with every default filled in, as sorted plain JSON data that loads again."""
        plain = self.experiment.model_dump(mode="json", by_alias=True, exclude_none=True)
        return json.loads(_canonical(plain))  # type: ignore[no-any-return]

    def section_key(self, *names: str | tuple[str, ...]) -> str:
        """Give a key (64 hex digits) that changes if and only if a value in the named sections does.

        Comments, the order of keys and 1 instead of 1.0 make no difference.

        Args:
            names: top-level sections such as ``"simulate"``, or paths such as ``("estimate", "methods", "em")``;
                a section that the experiment does not have counts as empty.
        """
        chosen = {}
        for name in names:
            path = (name,) if isinstance(name, str) else name
            value: Any = self.resolved()
            for step in path:
                value = value.get(step) if isinstance(value, dict) else None
            chosen["/".join(path)] = value
        return hashlib.sha256(_canonical(chosen).encode()).hexdigest()


def _canonical(data: Any) -> str:
    return json.dumps(data, sort_keys=True, allow_nan=False, separators=(",", ":"))


def load_experiment(path: FilePath | str, overrides: Iterable[str] = (), seed: int | None = None) -> LoadedExperiment:
    """Read and check an experiment file.

    Args:
        path: the file.
        overrides: settings that replace those of the file, as ``a.b=VALUE``.
        seed: replaces the file's seed.

    Raises:
        DataError: the file cannot be read.
        ConfigError: something in the file or the overrides is wrong; it carries every problem found.
    """
    file = FilePath(path)
    document = read_yaml(file)
    problems = settings.apply(document, overrides, seed)
    experiment, wrong = validate(document)
    problems = list(dict.fromkeys([*document.problems, *problems, *wrong]))
    if problems or experiment is None:
        raise ConfigError(str(path), first_problems(problems))
    return LoadedExperiment(experiment, file, document)


def validate(document: Document) -> tuple[Experiment | None, list[Problem]]:
    """Check the data of a document against the schema; give the experiment, or None, and what is wrong."""
    from pydantic import ValidationError

    from noiseid_cli.config.messages import to_problem
    from noiseid_cli.config.schema import Experiment, data_problem

    if not isinstance(document.data, dict):
        what = "the file is empty" if document.data is None else "the file must hold settings"
        return None, [document.problem((), f"{what}: it starts with `experiment: name`")]
    try:
        return Experiment.model_validate(document.data), []
    except ValidationError as error:
        found = [to_problem(entry, document) for entry in error.errors(include_url=False)]
        # pydantic compares settings with each other only once each of them is right; this one need not wait.
        if message := data_problem(document.data):
            found.append(document.problem((), message))
        return None, [problem for problem in found if problem is not None]


def first_problems(problems: list[Problem]) -> list[Problem]:
    """Keep as many problems as somebody will read, and say how many follow."""
    ordered = sorted(problems, key=lambda p: (p.line, p.column))
    kept, left = ordered[:MAX_PROBLEMS], len(ordered) - MAX_PROBLEMS
    if left > 0:
        kept.append(Problem(kept[-1].line, kept[-1].column, "", f"{left} more problems follow"))
    return kept


class Found(NamedTuple):
    """An experiment file, and a sentence that says which one was taken."""

    file: FilePath
    sentence: str


def builtin_experiment() -> FilePath:
    """Give the experiment that comes with noiseid: EM on a simulated flexible robot."""
    return FilePath(__file__).with_name("quickstart.yaml")


def find_experiment(argument: FilePath | str | None = None) -> Found:
    """Choose the experiment file: the argument, else ``noiseid.yaml`` in this folder, else the built-in one."""
    if argument is not None:
        return Found(FilePath(argument), f"experiment: {argument}")
    here = FilePath("noiseid.yaml")
    if here.exists():
        return Found(here, "experiment: noiseid.yaml in this folder")
    return Found(
        builtin_experiment(),
        "experiment: the built-in flexible_robot, since none was named and there is no noiseid.yaml in this folder",
    )

"""A starter experiment made for a log: the columns found and mapped, start values taken from the data."""

from __future__ import annotations

import keyword
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from noiseid_cli.errors import DataError

if TYPE_CHECKING:
    from noiseid_cli.models.equations import Model
    from noiseid_cli.recordings.proposals import Proposal
    from noiseid_cli.recordings.roles import ColumnRole
    from noiseid_cli.recordings.survey import Survey
    from noiseid_cli.recordings.table import Key
    from noiseid_cli.recordings.time_column import TimeFound

MODEL_FILE = "my_model.py"
MODEL_CLASS = "MyModel"


@dataclass(frozen=True)
class Wishes:
    """What the user says about a log; what is left empty is found out.

    Attributes:
        model: name of a model, or ``FILE.py:CLASS``; empty for a starter model made from the log.
        time: the time column.
        interval: s between rows, where there is no time column.
        inputs, outputs: columns, or ``NAME=COLUMN`` with a name of the model's.
    """

    model: str = ""
    time: str = ""
    interval: float | None = None
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()


@dataclass(frozen=True)
class Plan:
    """What is known about a log when its experiment is written.

    Attributes:
        config, log: the file to be written, and the log.
        found, time, roles: what was seen in the log.
        inputs, outputs: the column of each of the model's inputs and outputs.
        proposals: what to do about faults.
        model: the model; None for the starter model.
        model_name: how the user called it.
    """

    config: Path
    log: Path
    found: Survey
    time: TimeFound
    roles: tuple[ColumnRole, ...]
    inputs: dict[str, Key]
    outputs: dict[str, Key]
    proposals: tuple[Proposal, ...]
    model: Model | None
    model_name: str

    def relative(self, file: Path) -> str:
        """How the experiment file names another file."""
        return Path(os.path.relpath(file.absolute(), self.config.absolute().parent)).as_posix()

    @property
    def label(self) -> str:
        """Name of the experiment and of the recording: the log's, in letters that both allow."""
        text = re.sub(r"[^A-Za-z0-9_.-]+", "_", self.log.stem).strip("_.-")[:60]
        return text or "log"


def plan_starter(log: Path, config: Path, wishes: Wishes) -> Plan:
    """Look at a log and decide what its experiment says.

    Args:
        log: the recording, in any format that ``noiseid import`` reads.
        config: where the experiment will be written.
        wishes: what the user says.

    Raises:
        DataError: the log cannot be read, or its columns cannot be told apart.
        ModelError: there is no such model.
    """
    from noiseid_cli.models.registry import find_model
    from noiseid_cli.recordings.options import RecordingSource
    from noiseid_cli.recordings.proposals import propose
    from noiseid_cli.recordings.roles import find_roles
    from noiseid_cli.recordings.survey import survey
    from noiseid_cli.recordings.time_column import find_time

    model = find_model(wishes.model) if wishes.model else None
    found = survey(RecordingSource(log.stem, log))
    time = find_time(found, found.find(wishes.time) if wishes.time else None, wishes.interval)
    roles = find_roles(found, time)
    if model is None:
        inputs, outputs = _own_columns(found, roles, wishes)
    else:
        inputs, outputs = _model_columns(model, found, time, wishes)
    proposals = propose(found, time, list(inputs.values()), list(outputs.values()))
    return Plan(config, log, found, time, roles, inputs, outputs, proposals, model, wishes.model)


def _own_columns(found: Survey, roles: tuple[ColumnRole, ...], wishes: Wishes) -> tuple[dict[str, Key], dict[str, Key]]:
    """The columns of the starter model, under names made of theirs."""
    for word in (*wishes.inputs, *wishes.outputs):
        if "=" in word:
            raise DataError(f"{word}: NAME=COLUMN goes with --model; the starter model takes its names from the log")
    inputs = [found.find(word) for word in wishes.inputs]
    outputs = [found.find(word) for word in wishes.outputs]
    if both := [key for key in inputs if key in outputs]:
        raise DataError(f"column {both[0]!r} cannot be an input and an output")
    # What the user says of one side says nothing of the other.
    inputs = inputs or [r.key for r in roles if r.role == "input" and r.key not in outputs]
    outputs = outputs or [r.key for r in roles if r.role == "output" and r.key not in inputs]
    if not outputs:
        raise DataError(
            f"{found.source.file}: no column looks like a measured output: "
            + "; ".join(f"{r.key}: {r.why}" for r in roles)
            + ". Say which ones are with --output COLUMN"
        )
    if dead := [key for key in outputs if found.column(key).constant]:
        raise DataError(
            f"{found.source.file}: column {dead[0]!r} never changes, so there is no noise to be found in it"
        )
    taken: set[str] = set()
    return {_identifier(key, taken): key for key in inputs}, {_identifier(key, taken): key for key in outputs}


def _model_columns(
    model: Model, found: Survey, time: TimeFound, wishes: Wishes
) -> tuple[dict[str, Key], dict[str, Key]]:
    """The columns of a given model's inputs and outputs."""
    from noiseid_cli.recordings.matching import match_columns

    free = [column.key for column in found.columns if column.key != time.key]
    said = {}
    for word, texts in (("input", wishes.inputs), ("output", wishes.outputs)):
        pairs = [text.partition("=") for text in texts]
        if lone := [name for name, equals, _ in pairs if not equals]:
            raise DataError(f"--{word} {lone[0]}: with --model, write --{word} NAME=COLUMN, the model's name first")
        said[word] = {name: found.find(column) for name, _, column in pairs}
    outputs = match_columns("output", [q.name for q in model.outputs], found, free, said["output"])
    free = [key for key in free if key not in outputs.values()]
    return match_columns("input", [q.name for q in model.inputs], found, free, said["input"]), outputs


def _identifier(key: Key, taken: set[str]) -> str:
    """A name for equations that resembles a column's, and that no other column has."""
    text = re.sub(r"\[[^\[\]]*[^\d\[\]][^\[\]]*\]|\([^()]*\)", "", str(key).rpartition("/")[2])  # units in brackets
    name = re.sub(r"\W+", "_", text, flags=re.ASCII).strip("_")
    if not name or name[0].isdigit() or keyword.iskeyword(name):
        name = f"column_{name}".rstrip("_")
    number, unique = 2, name
    while taken & derived_names(unique):
        number, unique = number + 1, f"{name}_{number}"
    taken |= derived_names(unique)
    return unique


def derived_names(name: str) -> set[str]:
    """The names that the starter model makes of that of an output: itself, its speed, its noise."""
    return {name, f"{name}_speed", f"v_{name}"}


def unit_of(key: Key) -> str:
    """The unit in brackets at the end of a column's name; empty if there is none."""
    match = re.search(r"[\[(]([^\[\]()]*[^\d\[\]()][^\[\]()]*)[\])]\s*$", str(key))
    return match[1].strip() if match else ""

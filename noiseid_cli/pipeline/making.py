"""One unit of work: made, and told of in a token."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

from noiseid_cli.errors import NO_MEMORY, DamagedError, MachineError, NoiseidError, machine_error
from noiseid_cli.pipeline.context import Context
from noiseid_cli.pipeline.unit import DatasetUnit, EstimateUnit
from noiseid_cli.pipeline.wording import counted

Unit = DatasetUnit | EstimateUnit
State = Literal["made", "there", "to do", "failed", "damaged"]


@dataclass(frozen=True)
class Token:
    """How one unit ended.

    Attributes:
        unit: its name.
        path: its file.
        state: ``made`` now, ``there`` already, still ``to do``, or ``failed`` without a usable file; ``damaged``: what
            is there is not what was written, and gives way to a new one.
        message: for ``failed`` and ``damaged``, why; else a short result.
        status: of an estimate, see ``estimators.estimate.Status``; empty for a dataset.
        seconds: wall-clock time.
        tries: how often it was tried in this run.
    """

    unit: str
    path: Path
    state: State
    message: str = ""
    status: str = ""
    seconds: float = 0.0
    tries: int = 1

    @property
    def unfinished(self) -> bool:
        """An estimate is there, but it did not converge."""
        return self.status not in ("", "converged")


class Listener:
    """Is told what goes on. This one does not listen; others take up what they want to hear."""

    def stage(self, name: str, total: int, there: int) -> None:
        """A stage begins, with so many units of which some are there already."""

    def begin(self, unit: str) -> None:
        """A unit begins."""

    def compiling(self, unit: str, count: int, kernel: str) -> None:
        """A unit waits for a kernel that is compiled: the first, second, ... of those that it waited for."""

    def passed(self, unit: str, passes: int, loglik: float) -> None:
        """An estimation unit has passed over its data once more."""

    def end(self, token: Token) -> None:
        """A unit has ended."""

    def say(self, sentence: str) -> None:
        """Something worth a sentence; a listener leaves out what it has heard before."""


def ending(unit: Unit) -> tuple[str, str]:
    """Status and reason of the estimate in a unit's file, empty for a dataset, after the file was checked.

    Raises:
        DataError: it cannot be used; DamagedError: it is not what was written.
    """
    from noiseid_cli.storage.hdf5 import read_format
    from noiseid_cli.storage.result_file import read_result_attributes

    if isinstance(unit, DatasetUnit):
        read_format(unit.path)
        return "", ""
    kept = read_result_attributes(unit.path)
    return kept["status"], kept["reason"]


def found(unit: Unit) -> Token:
    """Token of a unit that is there, after its file was checked; the status of an estimate is read from it."""
    try:
        status, _ = ending(unit)
    except MachineError:
        raise
    except DamagedError as error:
        return Token(unit.name, unit.path, "damaged", str(error))
    except NoiseidError as error:
        return Token(unit.name, unit.path, "failed", str(error))
    return Token(unit.name, unit.path, "there", status, status)


def make(context: Context, unit: Unit, listener: Listener) -> Token:
    """Run one unit; an error that it raises on purpose becomes its token.

    Raises:
        MachineError: the disk is full or faulty, so that the units after this one would fail as well.
    """
    from noiseid_cli.pipeline.kernels import kernels_announced

    context = context.at(unit.point_index)
    listener.begin(unit.name)
    began = time.perf_counter()
    try:
        with kernels_announced(listener.say, partial(listener.compiling, unit.name)):
            if isinstance(unit, DatasetUnit):
                message, status = _make_dataset(context, unit, listener), ""
            else:
                message, status = _make_estimate(context, unit, listener)
    except MachineError:
        raise
    except OSError as error:
        if fault := machine_error(error):
            raise fault from error
        raise
    except (NoiseidError, MemoryError) as error:  # other units may need less memory
        reason = NO_MEMORY if isinstance(error, MemoryError) else str(error)
        return Token(unit.name, unit.path, "failed", reason, seconds=time.perf_counter() - began)
    return Token(unit.name, unit.path, "made", message, status, time.perf_counter() - began)


def _make_dataset(context: Context, unit: DatasetUnit, listener: Listener) -> str:
    from noiseid_cli.diagnostics.data_properties import data_warnings
    from noiseid_cli.pipeline.datasets import make_dataset

    dataset = make_dataset(context, unit)
    if unit.recordings:
        for warning in data_warnings(dataset):
            listener.say(f"{unit.name}: {warning}")
    recordings = dataset.recordings
    return f"{counted(len(recordings), 'test')}, {counted(sum(r.samples for r in recordings), 'sample')}"


def _make_estimate(context: Context, unit: EstimateUnit, listener: Listener) -> tuple[str, str]:
    from noiseid_cli.pipeline.estimation import make_estimate

    estimate = make_estimate(context, unit, lambda k, loglik: listener.passed(unit.name, k, loglik)).estimate
    if estimate.loglik != estimate.loglik:  # not a number: it has not even begun
        return f"{estimate.status}: {estimate.reason}", estimate.status
    after = f"after {counted(estimate.passes, 'pass', 'passes')}"
    return f"{estimate.status} {after}, log-likelihood {estimate.loglik:.2f}", estimate.status

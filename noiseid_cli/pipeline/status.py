"""What there is of an experiment: done, failed, damaged or missing, unit by unit. Only looks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from noiseid_cli.errors import DataError
from noiseid_cli.pipeline.context import Context
from noiseid_cli.pipeline.making import Unit, ending
from noiseid_cli.pipeline.units import data_stage, dataset_units, estimate_units

Condition = Literal["done", "failed", "damaged", "missing"]


@dataclass(frozen=True)
class UnitStatus:
    """One unit.

    Attributes:
        unit: its name.
        stage: ``simulate``, ``import`` or ``estimate``.
        path: its file, there or not.
        condition: ``done``: the file is there and whole; ``failed``: it was tried in vain; ``missing``: not yet.
        status: of an estimate that is done, see ``estimators.estimate.Status``; else empty.
        reason: why it failed, why the file is damaged, or how the estimate ended.
        tries: how often it was tried in vain.
    """

    unit: str
    stage: str
    path: Path
    condition: Condition
    status: str = ""
    reason: str = ""
    tries: int = 0

    @property
    def word(self) -> str:
        """The condition, or the status of an estimate that did not converge."""
        return self.status if self.condition == "done" and self.status not in ("", "converged") else self.condition


@dataclass(frozen=True)
class ExperimentStatus:
    """All units of an experiment, in order.

    Attributes:
        units: the units.
        holder: who is at work in the folder, in words; empty if nobody is.
    """

    units: tuple[UnitStatus, ...]
    holder: str

    def counts(self) -> dict[str, dict[str, int]]:
        """Number of units by stage and word."""
        out: dict[str, dict[str, int]] = {}
        for unit in self.units:
            words = out.setdefault(unit.stage, {})
            words[unit.word] = words.get(unit.word, 0) + 1
        return out

    @property
    def astray(self) -> list[UnitStatus]:
        """The units that failed, are damaged or did not converge."""
        return [unit for unit in self.units if unit.word not in ("done", "missing")]


def experiment_status(context: Context, methods: list[str] | None = None) -> ExperimentStatus:
    """Look at every unit of an experiment.

    Args:
        context: the experiment.
        methods: as in ``estimate_units``.
    """
    from noiseid_cli.storage.lock import holder

    stages: list[tuple[str, Sequence[Unit]]] = [(data_stage(context), dataset_units(context))]
    if context.experiment.estimate is not None:
        stages.append(("estimate", estimate_units(context, methods)))
    found = tuple(_look(unit, stage) for stage, units in stages for unit in units)
    return ExperimentStatus(found, holder(context.folder))


def _look(unit: Unit, stage: str) -> UnitStatus:
    from noiseid_cli.storage.failure_file import read_failure

    if not unit.done:
        failure = read_failure(unit.path)
        if failure is None:
            return UnitStatus(unit.name, stage, unit.path, "missing")
        return UnitStatus(unit.name, stage, unit.path, "failed", reason=failure.reason, tries=failure.tries)
    try:
        status, reason = ending(unit)
    except DataError as error:
        return UnitStatus(unit.name, stage, unit.path, "damaged", reason=str(error))
    return UnitStatus(unit.name, stage, unit.path, "done", status, reason)

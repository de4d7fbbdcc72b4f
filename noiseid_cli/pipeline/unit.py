"""A unit of work: what is to be made, under which name, and whether it is there already."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from noiseid_cli.config.method_base import MethodOptions
from noiseid_cli.pipeline.starts import Start


@dataclass(frozen=True)
class DatasetUnit:
    """One dataset to be simulated or imported.

    Attributes:
        name: ``replicate-000``, or the name of the recording or of the experiment.
        key: 64 hex digits.
        path: the file.
        replicate: number of the simulated replicate, from 0.
        recordings: names of the recordings to import; empty for a simulation.
        held_out: no method sees it; estimates are scored on it.
        point: name of the sweep's point; empty without a sweep.
        point_index: its number.
    """

    name: str
    key: str
    path: Path
    replicate: int = 0
    recordings: tuple[str, ...] = ()
    held_out: bool = False
    point: str = ""
    point_index: int | None = None

    @property
    def own_name(self) -> str:
        """The name without the point: points that share a dataset share its file, so it cannot name one of them."""
        return self.name.removeprefix(f"{self.point}/") if self.point else self.name

    @property
    def done(self) -> bool:
        """The file is there."""
        return self.path.exists()


@dataclass(frozen=True)
class EstimateUnit:
    """One method, from one start, on one dataset.

    Attributes:
        dataset: the dataset's unit.
        label: label of the method in the experiment.
        options: the method's options.
        start: where it starts from.
        held_out: the dataset that the estimate is scored on besides its own.
        key, path: as in ``DatasetUnit``.
    """

    dataset: DatasetUnit
    label: str
    options: MethodOptions
    start: Start
    held_out: DatasetUnit | None
    key: str
    path: Path

    @property
    def needs(self) -> tuple[DatasetUnit, ...]:
        """The datasets that it reads."""
        return (self.dataset,) if self.held_out is None else (self.dataset, self.held_out)

    @property
    def name(self) -> str:
        """Label of the unit, as it is shown."""
        return f"{self.dataset.name}/{self.label}/start-{self.start.index}"

    @property
    def own_name(self) -> str:
        """The label without the point."""
        return f"{self.dataset.own_name}/{self.label}/start-{self.start.index}"

    @property
    def point_index(self) -> int | None:
        """Number of the sweep's point; None without a sweep."""
        return self.dataset.point_index

    @property
    def done(self) -> bool:
        """The file is there."""
        return self.path.exists()

"""How much memory a unit of work takes at once, and how much there is; so that too much is refused before the work.

The estimate counts the arrays that grow with the number of samples. It is from above: a test holds the peak of a run of
EM between 0.2 of it and the whole.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from noiseid_cli.errors import ConfigError, DataError
from noiseid_cli.pipeline.context import Context
from noiseid_cli.pipeline.unit import DatasetUnit, EstimateUnit

GIB = 2**30
PROCESS = 250 * 2**20
"""What a worker process takes before it has any data: interpreter, libraries, kernels (measured: at most 241)."""

_NUMBER = 8  # bytes
_COPIES = 3  # of a dataset: the arrays, the padded ones of the file, the image of the file
_WORK_COPIES = 2  # chosen: Alg. 3, which keeps most, takes 1.1 of the filter's and smoother's arrays
_PER_BYTE_OF_LOG = 4  # measured on a CSV file of 17 MiB: 3.5
_CGROUPS = (
    (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory.current")),
    (Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"), Path("/sys/fs/cgroup/memory/memory.usage_in_bytes")),
)
_MEMINFO = Path("/proc/meminfo")


@dataclass(frozen=True)
class DataSize:
    """Size of one dataset.

    Attributes:
        samples: of the longest test.
        tests: number of tests.
        states, inputs, outputs, noises: of the model.
        others: further columns, such as parameters that change.
    """

    samples: int
    tests: int
    states: int
    inputs: int
    outputs: int
    noises: int
    others: int = 0

    @property
    def data(self) -> float:
        """Bytes to make, write or read the dataset: inputs, outputs, true states, time and interval of each sample."""
        columns = self.states + self.inputs + self.outputs + self.others + 2
        return float(self.samples) * self.tests * columns * _NUMBER * _COPIES

    @property
    def work(self) -> float:
        """Bytes of a filter and a smoother on the longest test: the tests are worked on one after the other.

        The filter keeps two means, two factors and three Jacobians a sample, the smoother a mean, a factor, a gain and
        a factor of the states with the noises (``filters.ekf.Filtered``, ``filters.smoother.Smoothed``). EM keeps less,
        and steps that share their gain take no room for it.
        """
        n, v, y = self.states, self.noises, self.outputs
        kept = 2 * n + 3 * n * n + n * v + y * n + y
        smoothed = n + n * n + (n + v) * n + (n + v) * (n + v)
        return float(self.samples) * (kept + smoothed) * _NUMBER * _WORK_COPIES


def check_memory(context: Context, units: Sequence[DatasetUnit | EstimateUnit], jobs: int) -> None:
    """Refuse units that need more memory than there is, before any of them is begun.

    Args:
        context: the opened experiment.
        units: what is to be made; datasets that estimates need are there, or are made by the same experiment.
        jobs: so many of them at once; with more than one, in processes of their own.

    Raises:
        ConfigError: a single unit needs too much; with the place of the setting to change.
        DataError: the datasets are too large, or too many units are to run at once.
    """
    needs, there = memory_needs(context, units), memory_there()
    if not needs:
        return
    process = PROCESS if jobs > 1 else 0
    largest, name = needs[0]
    if largest + process > there:
        _refuse(context, name, largest + process, there)
    together = [need + process for need, _ in needs[:jobs]]
    if sum(together) > there:
        fit = next(n for n in range(len(together), 0, -1) if sum(together[:n]) <= there)
        raise DataError(
            f"--jobs {jobs}: so many units at once need about {in_words(sum(together))} of memory, and "
            f"{in_words(there)} are free: --jobs {fit} fits"
        )


def memory_needs(context: Context, units: Sequence[DatasetUnit | EstimateUnit]) -> list[tuple[float, str]]:
    """Bytes that each unit takes at once and its name, the largest first; 0 where its dataset is not there yet."""
    sizes = cache(_size_of_file)
    needs = [(_need(context.at(unit.point_index), unit, sizes), unit.name) for unit in units]
    return sorted(needs, key=lambda need: -need[0])


def _refuse(context: Context, name: str, need: float, there: float) -> None:
    said = f"{name} needs about {in_words(need)} of memory, and {in_words(there)} are free: "
    section = context.experiment.simulate
    if section is None:
        raise DataError(said + "take a shorter range (rows of a recording), or fewer samples (import.decimate)")
    tests = f" x {section.tests} tests" if section.tests > 1 else ""
    problem = context.loaded.problem(
        ("simulate", "samples"),
        f"{said}{section.samples} samples{tests} are asked for: take fewer samples"
        + (" or tests" if section.tests > 1 else ", or several shorter tests"),
    )
    raise ConfigError(str(context.loaded.file), [problem])


def _need(context: Context, unit: DatasetUnit | EstimateUnit, sizes: Callable[[Path], DataSize]) -> float:
    """Bytes that a unit takes at once."""
    section = context.experiment.simulate
    if section is None and isinstance(unit, DatasetUnit):
        return _PER_BYTE_OF_LOG * _log_bytes(context, unit)
    if section is None:
        assert isinstance(unit, EstimateUnit)
        size = sizes(unit.dataset.path)
        model = context.model
        size = replace(size, states=len(model.states), noises=len(model.noises))
    else:
        model = context.model
        changing = len(model.parameters) if section.parameter_changes else 0
        groups = (model.states, model.inputs, model.outputs, model.noises)
        states, inputs, outputs, noises = (len(group) for group in groups)
        size = DataSize(section.samples, section.tests, states, inputs, outputs, noises, changing)
    return size.data + (size.work if isinstance(unit, EstimateUnit) else 0.0)


def _log_bytes(context: Context, unit: DatasetUnit) -> int:
    """Size of the log files of a dataset."""
    section = context.experiment.import_
    assert section is not None
    total = 0
    for name in unit.recordings:
        source = section.recordings[name]
        for file in (source.file, *(other.file for other in source.also)):
            with suppress(OSError):  # told of when it is read
                total += context.loaded.resolve(file).stat().st_size
    return total


def _size_of_file(path: Path) -> DataSize:
    """Size of a dataset that is there; nothing where it cannot be read, which the unit itself tells of."""
    from noiseid_cli.storage.dataset_file import read_size

    try:
        samples, tests, inputs, outputs = read_size(path)
    except DataError:
        return DataSize(0, 0, 0, 0, 0, 0)
    return DataSize(samples, tests, 0, inputs, outputs, 0)


def memory_there() -> float:
    """Bytes that a new process can have: what the machine has free, or less where a control group allows less."""
    free = _machine_free()
    for limit, used in _CGROUPS:
        with suppress(OSError, ValueError):  # no such group, or "max": no limit
            free = min(free, max(0, int(limit.read_text()) - int(used.read_text())))
    return float(free)


def _machine_free() -> int:
    with suppress(OSError, ValueError, IndexError):
        for line in _MEMINFO.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    # Elsewhere than on Linux: all that is built in.
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def in_words(size: float) -> str:
    """A size in words."""
    return f"{size / GIB:.3g} GiB" if size >= GIB else f"{size / 2**20:.3g} MiB"

"""What a unit costs beside its own work, what a worker process costs, and what two processes gain.

python benchmarks/reliability/overhead.py
"""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
from pathlib import Path
from types import SimpleNamespace

sys.path.insert(0, str(Path(__file__).parent))

from sweep_of_500 import warm_up, write_config

from noiseid_cli.pipeline import datasets, making
from noiseid_cli.pipeline.context import open_experiment
from noiseid_cli.pipeline.engine import run_units
from noiseid_cli.pipeline.units import dataset_units
from noiseid_cli.storage.dataset_file import write_dataset


class Silent:
    """A listener that heeds nothing."""

    def __getattr__(self, _: str):  # type: ignore[no-untyped-def]
        return lambda *_: None


def seconds(context, jobs: int, time_limit: float | None = None) -> float:  # type: ignore[no-untyped-def]
    """Wall-clock time to make every dataset anew."""
    began = time.perf_counter()
    tokens = run_units(context, "simulate", dataset_units(context), Silent(), jobs, force=True, time_limit=time_limit)
    assert all(token.state == "made" for token in tokens)
    return time.perf_counter() - began


def main(folder: Path) -> None:
    """Measure, and print."""
    warm_up()
    file = write_config(folder)
    context = open_experiment(file, folder)
    units = dataset_units(context)
    seconds(context, 1)  # everything is compiled and loaded now
    with_work = statistics.median(seconds(context, 1) for _ in range(3))
    real, dataset = datasets.make_dataset, datasets._simulate(context.at(units[0].point_index), units[0])

    def empty(_: object, unit: making.Unit) -> object:
        write_dataset(unit.path, dataset, {})
        return SimpleNamespace(recordings=())

    datasets.make_dataset = empty  # type: ignore[assignment]
    bare = statistics.median(seconds(context, 1) for _ in range(3))
    datasets.make_dataset = real
    print(f"{len(units)} units that only write their file: {1e3 * bare / len(units):.2f} ms each")
    print(f"{len(units)} units of a simulation of 60 samples: {1e3 * with_work / len(units):.2f} ms each")
    one = open_experiment(file, folder, ["simulate.replicates=1", "sweep.axes.gain.values=[0.9]"])
    here, apart = (statistics.median(seconds(one, 1, limit) for _ in range(3)) for limit in (None, 600.0))
    print(f"a worker process for one unit costs {apart - here:.2f} s")
    long = ["simulate.samples=20000", "sweep.axes.gain.values=[0.9]", "simulate.replicates=20"]
    context = open_experiment(file, folder, long)
    alone, two = (statistics.median(seconds(context, jobs) for _ in range(3)) for jobs in (1, 2))
    print(f"20 units of 20000 samples: {alone:.1f} s with --jobs 1, {two:.1f} s with --jobs 2: {alone / two:.2f} times")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory(prefix="overhead-") as place:
        main(Path(place))

"""What a unit costs beside its own work, what a worker process costs, and what two processes gain: one table.

    python benchmarks/reliability/overhead.py [REPLICATES]

The sweep that is shared out has eight estimates a replicate, and three replicates unless told otherwise: the start of
the workers is a smaller part of more of them.
On a machine that is busy the figures say little: its load stands in the table.
"""

from __future__ import annotations

import os
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

sys.path.insert(0, str(Path(__file__).parent))

from sweep_of_500 import warm_up, write_config

from noiseid_cli.pipeline import datasets, making
from noiseid_cli.pipeline.context import Context, open_experiment
from noiseid_cli.pipeline.engine import run_units
from noiseid_cli.pipeline.units import dataset_units, estimate_units
from noiseid_cli.storage.dataset_file import write_dataset

SAMPLES = 50000
TIMES = 3  # each figure is the median of so many


class Silent:
    """A listener that heeds nothing."""

    def __getattr__(self, _: str):  # type: ignore[no-untyped-def]
        return lambda *_: None


def seconds(context: Context, stage: str, jobs: int, time_limit: float | None = None) -> float:
    """Wall-clock time to make every unit of a stage anew."""
    units: Sequence[making.Unit] = dataset_units(context) if stage == "simulate" else estimate_units(context)
    began = time.perf_counter()
    tokens = run_units(context, stage, units, Silent(), jobs, force=True, time_limit=time_limit)
    assert all(token.state == "made" for token in tokens)
    return time.perf_counter() - began


def median(*arguments, **named) -> float:  # type: ignore[no-untyped-def]
    """The median of a few times."""
    return statistics.median(seconds(*arguments, **named) for _ in range(TIMES))


def unit_costs(context: Context) -> tuple[float, float]:
    """Seconds for a unit that only writes its file, and for one that simulates 60 samples."""
    units = dataset_units(context)
    seconds(context, "simulate", 1)  # everything is compiled and loaded now
    with_work = median(context, "simulate", 1)
    real, dataset = datasets.make_dataset, datasets._simulate(context.at(units[0].point_index), units[0])

    def empty(_: object, unit: making.Unit) -> object:
        write_dataset(unit.path, dataset, {})
        return SimpleNamespace(recordings=())

    datasets.make_dataset = empty  # type: ignore[assignment]
    bare = median(context, "simulate", 1)
    datasets.make_dataset = real
    return bare / len(units), with_work / len(units)


def main(folder: Path, replicates: int) -> None:
    """Measure, and print."""
    load = os.getloadavg()[0]
    warm_up()
    file = write_config(folder)
    bare, with_work = unit_costs(open_experiment(file, folder))
    one = open_experiment(file, folder, ["simulate.replicates=1", "sweep.axes.gain.values=[0.9]"])
    here, apart = (median(one, "simulate", 1, time_limit=limit) for limit in (None, 600.0))
    sweep = open_experiment(file, folder, [f"simulate.samples={SAMPLES}", f"simulate.replicates={replicates}"])
    count = len(estimate_units(sweep))
    seconds(sweep, "simulate", 1)
    seconds(sweep, "estimate", 1)  # compiled and loaded
    alone, two = (median(sweep, "estimate", jobs) for jobs in (1, 2))
    rows = [
        (f"load before, on {os.cpu_count()} cores", f"{load:.1f}"),
        ("unit that only writes its file", f"{1e3 * bare:.1f} ms"),
        ("unit that simulates 60 samples", f"{1e3 * with_work:.1f} ms"),
        ("worker process for one unit", f"{apart - here:.2f} s"),
        (f"{count} estimates of {alone / count:.2f} s, --jobs 1", f"{alone:.1f} s"),
        (f"{count} estimates, --jobs 2", f"{two:.1f} s"),
        ("speed-up of --jobs 2", f"{alone / two:.2f} times"),
    ]
    width = max(len(what) for what, _ in rows)
    for what, figure in rows:
        print(f"{what:<{width}}  {figure:>10}")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory(prefix="overhead-") as place:
        main(Path(place), int(sys.argv[1]) if len(sys.argv) > 1 else 3)

"""Work that needs more memory than there is is refused before it begins, with the estimate and what to change."""

import os
import subprocess
import sys

import pytest
from small_experiment import MEASURED, noiseid, write_experiment, write_recordings

from noiseid_cli.errors import ConfigError, DataError
from noiseid_cli.pipeline import memory
from noiseid_cli.pipeline.context import open_experiment
from noiseid_cli.pipeline.engine import run_units
from noiseid_cli.pipeline.memory import GIB, PROCESS, DataSize, check_memory, memory_needs, memory_there
from noiseid_cli.pipeline.units import dataset_units, estimate_units


class Silent:
    """A listener that heeds nothing."""

    def __getattr__(self, _):
        return lambda *_: None


def opened(file, *overrides):
    return open_experiment(file, file.parent / "runs", overrides)


def free(monkeypatch, size):
    monkeypatch.setattr(memory, "memory_there", lambda: float(size))


def test_what_is_counted():
    size = DataSize(samples=1000, tests=3, states=4, inputs=1, outputs=2, noises=2)
    assert size.data == 1000 * 3 * (4 + 1 + 2 + 2) * 8 * 3
    # Filter: means 8, factors and F 48, G 8, H 8, innovations 2; smoother: mean 4, factor 16, gain 24, C 36.
    assert size.work == 1000 * (8 + 48 + 8 + 8 + 2 + 4 + 16 + 24 + 36) * 8 * 2
    more = DataSize(samples=1000, tests=3, states=4, inputs=1, outputs=2, noises=2, others=5)
    assert more.data - size.data == 1000 * 3 * 5 * 8 * 3


def test_what_there_is(tmp_path, monkeypatch):
    meminfo, limit, used = (tmp_path / name for name in ("meminfo", "max", "current"))
    monkeypatch.setattr(memory, "_MEMINFO", meminfo)
    monkeypatch.setattr(memory, "_CGROUPS", ((limit, used),))
    built_in = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    assert memory_there() == built_in  # no such files
    meminfo.write_text("MemTotal: 9 kB\nMemAvailable:    2048 kB\n")
    assert memory_there() == 2048 * 1024
    used.write_text("1000\n")
    limit.write_text("max\n")
    assert memory_there() == 2048 * 1024
    limit.write_text("5000\n")
    assert memory_there() == 4000
    used.write_text("6000\n")
    assert memory_there() == 0


def test_a_unit_that_is_too_large_is_told_with_its_place(tmp_path, monkeypatch):
    context = opened(write_experiment(tmp_path), "simulate.samples=1e12")
    units = dataset_units(context)
    with pytest.raises(ConfigError, match=r"replicate-000 needs about 1.34e\+05 GiB.*several shorter") as told:
        run_units(context, "simulate", units, Silent())
    assert told.value.problems[0].path == "simulate.samples"
    assert not (tmp_path / "runs/small/datasets").exists()
    free(monkeypatch, memory_needs(context, units)[0][0])
    check_memory(context, units, 1)  # to the byte
    with pytest.raises(ConfigError):
        check_memory(context, units, 2)  # a process of its own takes more
    free(monkeypatch, GIB)
    context = opened(tmp_path / "noiseid.yaml", "simulate.samples=1e6", "simulate.tests=1e6")
    with pytest.raises(ConfigError, match="1000000 samples x 1000000 tests are asked for: take fewer samples or tests"):
        check_memory(context, dataset_units(context), 1)
    told = noiseid("check", tmp_path / "noiseid.yaml", "--set", "simulate.samples=1e12")
    assert told.exit_code == 3
    assert "simulate.samples: replicate-000/em/start-" in told.stderr
    said = noiseid("check", tmp_path / "noiseid.yaml").stdout
    assert "memory    about 0.0623 MiB at once for the largest unit; 1 GiB are free" in said


def test_too_many_units_at_once_are_told_how_many_fit(tmp_path, monkeypatch):
    context = opened(write_experiment(tmp_path), "simulate.replicates=5")
    units = dataset_units(context)
    one = memory_needs(context, units)[0][0] + PROCESS
    free(monkeypatch, 3.5 * one)
    check_memory(context, units, 3)
    with pytest.raises(
        DataError, match=r"--jobs 5: so many units at once need about .* GiB of memory, .*: --jobs 3 fits"
    ):
        check_memory(context, units, 5)
    check_memory(context, [], 5)


def test_each_point_of_a_sweep_counts_with_its_own_size(tmp_path):
    sweep = "sweep:\n  axes:\n    n: {vary: simulate.samples, values: [100, 400, 200]}\n"
    file = write_experiment(tmp_path)
    file.write_text(file.read_text() + sweep)
    context = opened(file)
    needs = memory_needs(context, dataset_units(context))
    assert [name for _, name in needs] == [
        "point-001/replicate-000",
        "point-002/replicate-000",
        "point-000/replicate-000",
    ]
    assert needs[0][0] == 4 * needs[2][0]


def test_logs_count_by_their_size_and_datasets_by_what_they_hold(tmp_path, monkeypatch):
    write_experiment(tmp_path, MEASURED)
    write_recordings(tmp_path)
    context = opened(tmp_path / "noiseid.yaml", "import.recordings={good: {file: good.csv}}")
    units = dataset_units(context)
    assert memory_needs(context, units) == [(4.0 * (tmp_path / "good.csv").stat().st_size, "good")]
    estimates = estimate_units(context)
    assert [need for need, _ in memory_needs(context, estimates)] == [0.0] * 2  # there is no dataset yet

    run_units(context, "import", units, Silent())
    wanted = DataSize(80, 1, states=2, inputs=1, outputs=1, noises=1)
    assert [need for need, _ in memory_needs(context, estimates)] == [wanted.data + wanted.work] * 2
    free(monkeypatch, 1000.0)
    with pytest.raises(DataError, match=r"good/em/start-0 needs about .* MiB .*\(import.decimate\)"):
        check_memory(context, estimates, 1)


PEAK = r"""
import re
from pathlib import Path

import numpy as np
from noiseid_cli.estimators import em
from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.estimators.unknowns import Unknowns
from noiseid_cli.models.linear import linear_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording

def run(n):
    y = np.random.default_rng(0).normal(size=(n, 2))
    y[::7] = np.nan  # so that covariances never come to rest, and no step shares its gain
    level = linear_model(0.9 * np.eye(4), np.eye(4)[:, :2], np.eye(4)[:2])
    start = NoiseValues(np.eye(2), np.eye(2), np.zeros((1, 4)), np.eye(4))
    unknowns = Unknowns(Q=CovarianceStructure.diagonal(start.Q, "Q"))
    test = Recording("t", np.ones(n - 1), np.zeros((n, 0)), y)
    em.estimate(level, [test], start, unknowns, em.EmOptions(max_passes=1))
    # The peak of this program: that of getrusage may be the one of the process that started it.
    return int(re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())[1]) * 1024

before = run(10)
print(before, run(100_000) - before)
"""


def test_the_estimate_is_above_the_peak_and_not_far_above():
    out = subprocess.run([sys.executable, "-c", PEAK], check=True, capture_output=True, text=True).stdout
    base, peak = map(int, out.split())
    size = DataSize(100_000, 1, states=4, inputs=0, outputs=2, noises=2)
    assert 0.2 < peak / (size.data + size.work) < 1.0
    assert base < 1.5 * PROCESS

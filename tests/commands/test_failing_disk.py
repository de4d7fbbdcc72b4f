"""A disk that fails at any call, and what a command says of it: exit code 1, nothing wrong is left, and on it goes."""

import errno
import io
import itertools
import os
import shutil
import subprocess
import time

import pytest
from fuzz import fuzzing
from small_experiment import COMMAND, MEASURED, noiseid, write_recordings

from noiseid_cli.errors import NO_MEMORY
from noiseid_cli.storage.hdf5 import read_format

LINEAR = """\
experiment: small
seed: 5
model: {linear: {A: [[0.9]], C: [[1]], discretisation: discrete, sample_time: 1}}
simulate:
  samples: 20
  trajectory: {kind: zero}
  process_noise: {std: [1]}
  measurement_noise: {std: [1]}
estimate:
  process_noise: {start: {std: [1]}}
  measurement_noise: {known: {std: [1]}}
  initial_mean: {known: [0]}
  initial_covariance: {known: {std: [1]}}
  methods: {em: {parameter_tolerance: 0.1}}
report: {formats: [csv]}
"""
FAULTS = {
    errno.ENOSPC: "the disk is full; free some space and run the same command again.",
    errno.EIO: "the disk reports a fault; check it, then run the same command again.",
    errno.EDQUOT: "the disk quota is used up; free some space and run the same command again.",
}


class Disk:
    """Counts the calls that change what is under a folder, and makes one of them fail."""

    def __init__(self, folder):
        self.folder, self.calls, self.fails_at, self.fault = str(folder.absolute()), [], 0, 0
        self.handles = set()
        self.real = {name: getattr(os, name) for name in ("open", "write", "fsync", "replace", "mkdir", "close")}
        self.real_open = io.open

    def install(self, monkeypatch):
        for name in self.real:
            monkeypatch.setattr(os, name, getattr(self, name))
        monkeypatch.setattr(io, "open", self.open_file)

    def reset(self, fails_at=0, fault=0):
        self.calls, self.fails_at, self.fault = [], fails_at, fault

    def inside(self, path):
        return not isinstance(path, int) and os.path.abspath(os.fspath(path)).startswith(self.folder)  # noqa: PTH100

    def count(self, call):
        self.calls.append(call)
        if len(self.calls) == self.fails_at:
            raise OSError(self.fault, os.strerror(self.fault))

    def open(self, path, flags, *rest, **named):
        if not self.inside(path):
            return self.real["open"](path, flags, *rest, **named)
        self.count("open")
        handle = self.real["open"](path, flags, *rest, **named)
        self.handles.add(handle)
        return handle

    def close(self, handle):
        self.handles.discard(handle)
        self.real["close"](handle)

    def write(self, handle, data):
        if handle in self.handles:
            self.count("write")
        return self.real["write"](handle, data)

    def fsync(self, handle):
        if handle in self.handles:
            self.count("fsync")
        self.real["fsync"](handle)

    def replace(self, source, target):
        if self.inside(target):
            self.count("replace")
        self.real["replace"](source, target)

    def mkdir(self, path, *rest):
        if self.inside(path) and not os.path.isdir(path):  # noqa: PTH112
            self.count("mkdir")
        self.real["mkdir"](path, *rest)

    def open_file(self, file, mode="r", *rest, **named):
        if not (self.inside(file) and set(mode) & set("wxa+")):
            return self.real_open(file, mode, *rest, **named)
        self.count("open file")
        self.real_open(file, "wb").close()  # a fault at the next call leaves an empty file, as it would on a disk
        self.count("write file")
        return self.real_open(file, mode, *rest, **named)


@pytest.fixture
def disk(empty, monkeypatch):
    (empty / "noiseid.yaml").write_text(LINEAR)
    disk = Disk(empty / "runs")
    # Bytes may be compared when no clock goes into them.
    monkeypatch.setattr(time, "perf_counter", lambda: 0.0)
    disk.install(monkeypatch)
    return disk


def contents(folder):
    """Every file but the locks and the index of the report, which hold times."""
    files = (p for p in folder.rglob("*") if p.is_file() and not p.name.startswith("."))
    return {str(p.relative_to(folder)): p.read_bytes() for p in files}


def some(calls):
    """Numbers of the calls that are made to fail: of the many equal files of the report, the first and the last.

    `make fuzz` takes every call.
    """
    tables = [n for n, call in enumerate(calls, 1) if call == "open file"]
    alike = range(tables[1], tables[-1]) if not fuzzing() else ()
    return [n for n in range(1, len(calls) + 1) if n not in alike]


def test_whichever_call_fails_the_run_ends_with_1_and_goes_on_to_the_same_bytes(empty, disk, tried):
    runs = empty / "runs"
    assert noiseid("run", "-q").exit_code == 0
    calls, whole = disk.calls, contents(runs)
    assert len([name for name in whole if name.endswith(".h5")]) == 2
    assert set(calls) == {"mkdir", "open", "write", "fsync", "replace", "open file", "write file"}
    for n, fault in zip(some(calls), itertools.cycle(FAULTS), strict=False):
        tried()
        shutil.rmtree(runs if n < calls.index("open file") else runs / "small/report")
        disk.reset(n if not runs.exists() else n - reports_begin(calls), fault)
        failed = noiseid("run", "-q")
        where = (n, calls[n - 1], failed.stderr)
        assert failed.exit_code == 1, where
        (line,) = failed.stderr.splitlines()
        assert line.startswith("noiseid: "), where
        assert line.endswith(FAULTS[fault]), where
        assert failed.stdout == ""
        disk.reset()
        for path in runs.rglob("*.h5"):
            read_format(path)
        assert not list(runs.rglob("*.part")), where
        assert not list(runs.rglob("*.failed.json")), where
        assert all(whole[name] == data for name, data in contents(runs).items()), where
        assert noiseid("run", "-q").exit_code == 0
        assert contents(runs) == whole, where


def reports_begin(calls):
    """Number of calls before those of the report, where all units are there: its lock comes first."""
    return calls.index("open file") - 4  # the lock, the folder, and the folder of its tables


def test_a_full_disk_in_other_places(small, monkeypatch):
    """Reading, exporting and starting an experiment."""

    def full(path, *_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    assert noiseid("run", "-q").exit_code == 0
    monkeypatch.setattr("noiseid_cli.storage.atomic._write", full)
    for words in (["init", "new.yaml"], ["export"], ["run", "--set", "seed=8"], ["run", "--force", "-q"]):
        told = noiseid(*words)
        assert told.exit_code == 1, words
        last = told.stderr.splitlines()[-1]
        assert "could not be written: No space left on device: the disk is full; free some space" in last
        assert "internal" not in told.stderr
    assert not (small.parent / "state").exists()  # no log of a bug
    monkeypatch.undo()


@pytest.mark.parametrize(
    ("words", "file"),
    [
        (["check"], "noiseid.yaml"),
        (["status"], "runs/small/results"),
        (["report"], "runs/small/datasets"),
        (["run", "log.yaml"], "good.csv"),
    ],
)
def test_a_disk_that_cannot_be_read_ends_with_1(small, monkeypatch, words, file):
    write_recordings(small)
    (small / "log.yaml").write_text(MEASURED.replace("    bad: {file: bad.csv}\n", ""))
    assert noiseid("run", "-q").exit_code == 0
    real = io.open

    def faulty(path, mode="r", *rest, **named):
        if file in str(path) and "b" in mode and "w" not in mode:
            raise OSError(errno.EIO, os.strerror(errno.EIO), str(path))
        return real(path, mode, *rest, **named)

    monkeypatch.setattr(io, "open", faulty)
    told = noiseid(*words)
    assert told.exit_code == 1, told.stderr
    assert told.stderr.endswith(f"cannot be read: Input/output error: {FAULTS[errno.EIO]}\n")


@pytest.mark.parametrize("words", [["schema"], ["--help"], ["--version"]])
def test_an_answer_that_finds_no_space_is_told_in_a_line(words):
    with open("/dev/full", "w") as full:  # noqa: PTH123
        told = subprocess.run([*COMMAND, *words], stdout=full, stderr=subprocess.PIPE, text=True, check=False)
        silent = subprocess.run([*COMMAND, *words], stdout=full, stderr=full, check=False)
    assert told.returncode == 1
    assert told.stderr.startswith("noiseid: the output")
    assert told.stderr.endswith(FAULTS[errno.ENOSPC] + "\n")
    assert told.stderr.count("\n") == 1
    assert silent.returncode == 1


def test_too_little_memory_for_the_report_is_no_bug(small, monkeypatch):
    def large(*_):
        raise MemoryError

    monkeypatch.setattr("noiseid_cli.report.make_report", large)
    told = noiseid("run", "-q")
    assert told.exit_code == 1
    assert told.stderr == f"noiseid: {NO_MEMORY}\n"


def test_a_bug_without_a_place_for_its_log_is_still_one_line(small, monkeypatch):
    def broken(*_):
        raise RuntimeError("the wheel came off")

    monkeypatch.setattr("noiseid_cli.pipeline.datasets.make_dataset", broken)
    (small.parent / "state").write_text("")
    monkeypatch.setattr("tempfile.tempdir", str(small / "nowhere"))
    told = noiseid("run", "-q")
    assert told.exit_code == 1
    assert told.stderr.splitlines()[-1] == (
        "noiseid: internal error: RuntimeError: the wheel came off; please report it; no log file could be written"
    )

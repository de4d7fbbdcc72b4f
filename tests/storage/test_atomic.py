"""Publishing a file: killed writers, failing calls, leftovers."""

import errno
import os
import subprocess
import sys
import time

import pytest

from noiseid_cli.errors import DataError, MachineError
from noiseid_cli.storage import atomic
from noiseid_cli.storage.atomic import publish, sweep_parts

WRITER = """
import sys, itertools
from pathlib import Path
from noiseid_cli.storage.atomic import publish
for k in itertools.count():
    publish(Path(sys.argv[1]), bytes([65 + k % 2]) * 3_000_000)
    print(k, flush=True)
"""


def test_publishes_bytes_and_makes_folders(tmp_path):
    path = tmp_path / "a" / "b.h5"
    publish(path, b"one")
    publish(path, b"two")
    assert path.read_bytes() == b"two"
    assert [p.name for p in path.parent.iterdir()] == ["b.h5"]


def test_a_killed_writer_leaves_the_old_or_the_new_file(tmp_path):
    path = tmp_path / "unit.h5"
    parts = 0
    for trial in range(10):
        writer = subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE)
        writer.stdout.readline()
        time.sleep(0.0013 * trial)
        writer.kill()
        writer.wait()
        writer.stdout.close()
        data = path.read_bytes()
        assert data in (b"A" * 3_000_000, b"B" * 3_000_000)
        parts += len(list(tmp_path.glob("*.part")))
        sweep_parts(tmp_path)
        assert [p.name for p in tmp_path.iterdir()] == ["unit.h5"]
    assert parts  # some trials did hit a write


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO, errno.EDQUOT])
@pytest.mark.parametrize(("call", "n"), [("open", 1), ("write", 1), ("fsync", 1), ("replace", 1), ("write", 2)])
def test_a_failing_call_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch, call, n, number):
    path = tmp_path / "unit.h5"
    publish(path, b"old")
    real, calls = getattr(os, call), []

    def failing(*args, **kwargs):
        calls.append(args)
        if len(calls) == n:
            raise OSError(number, os.strerror(number))
        if call == "write":  # a disk that takes a little at a time
            return real(args[0], args[1][:2])
        return real(*args, **kwargs)

    monkeypatch.setattr(atomic.os, call, failing)
    with pytest.raises(MachineError, match=r"unit\.h5 could not be written: .*run the same command again"):
        publish(path, b"new content")
    monkeypatch.undo()
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["unit.h5"]
    publish(path, b"new content")
    assert path.read_bytes() == b"new content"


def test_a_failing_folder_sync_is_reported_unless_the_file_system_has_none(tmp_path, monkeypatch):
    path = tmp_path / "unit.h5"
    real, seen = os.fsync, []

    def second_fails_with(number):
        def fsync(handle):
            seen.append(handle)
            if len(seen) % 2 == 0:
                raise OSError(number, os.strerror(number))
            real(handle)

        monkeypatch.setattr(atomic.os, "fsync", fsync)

    second_fails_with(errno.EINVAL)
    publish(path, b"new")
    second_fails_with(errno.EIO)
    with pytest.raises(MachineError, match="disk reports a fault"):
        publish(path, b"newer")
    assert [p.name for p in tmp_path.iterdir()] == ["unit.h5"]


def test_the_order_is_write_sync_rename_sync(tmp_path, monkeypatch):
    order = []
    for call in ("write", "fsync", "replace"):
        real = getattr(os, call)
        monkeypatch.setattr(
            atomic.os, call, lambda *a, real=real, call=call, **k: (order.append(call), real(*a, **k))[1]
        )
    publish(tmp_path / "unit.h5", b"x")
    assert order == ["write", "fsync", "replace", "fsync"]


def test_a_file_in_place_of_the_folder_and_too_long_a_name_are_named(tmp_path):
    (tmp_path / "runs").write_text("")
    with pytest.raises(DataError, match="a file stands where a folder is needed"):
        publish(tmp_path / "runs" / "unit.h5", b"")
    with pytest.raises(DataError, match="choose a shorter one"):
        publish(tmp_path / ("n" * 250), b"")


def test_sweep_keeps_living_writers_and_strangers(tmp_path):
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    here = atomic._machine()
    names = {
        "dead": f"u.h5.{here}-{gone.pid}-0.part",
        "alive": f"u.h5.{here}-{os.getpid()}-0.part",
        "elsewhere": f"u.h5.00000000-{gone.pid}-0.part",
        "old": f"u.h5.00000000-{gone.pid}-1.part",
        "stranger": "film.part",
    }
    for name in names.values():
        (tmp_path / name).write_bytes(b"x")
    os.utime(tmp_path / names["old"], (0, 0))
    os.utime(tmp_path / names["stranger"], (0, 0))
    assert {p.name for p in sweep_parts(tmp_path)} == {names["dead"], names["old"]}
    assert {p.name for p in tmp_path.iterdir()} == {names["alive"], names["elsewhere"], names["stranger"]}

"""One run at a time in a folder; a lock ends with its holder."""

import errno
import fcntl
import subprocess
import sys
import threading

import pytest

from noiseid_cli.errors import DataError
from noiseid_cli.storage import lock
from noiseid_cli.storage.lock import NAME, locked

HOLD = """
import sys
from pathlib import Path
from noiseid_cli.storage.lock import locked
with locked(Path(sys.argv[1]), print):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def holder(tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.wait()
    process.stdin.close()
    process.stdout.close()


def test_a_second_run_is_told_who_holds_the_folder(tmp_path, holder):
    with (
        pytest.raises(DataError, match=f"in use by process {holder.pid} on .* since 2.*--wait"),
        locked(tmp_path, print),
    ):
        pass


def test_the_lock_of_a_killed_run_is_free(tmp_path, holder):
    holder.kill()
    holder.wait()
    with locked(tmp_path, print):
        pass


def test_waiting_ends_when_the_other_run_does(tmp_path, holder):
    said = []

    def end(sentence):
        said.append(sentence)
        threading.Timer(0.1, holder.stdin.close).start()

    with locked(tmp_path, end, wait=True):
        assert holder.wait(5) == 0
    assert len(said) == 1
    assert said[0].startswith(f"Waiting for process {holder.pid} ")


def test_two_folders_do_not_disturb_each_other(tmp_path):
    a, b = tmp_path / "a", tmp_path / "b"
    with locked(a, print), locked(b, print), pytest.raises(DataError), locked(a, print):
        pass
    with locked(a, print):
        pass


@pytest.mark.parametrize("text", ["", "{", "[]", '{"process": "x"}', "\x1b[31m"])
def test_a_holder_that_signed_nothing_useful_is_another_run(tmp_path, text):
    with locked(tmp_path, print):
        (tmp_path / NAME).write_text(text)
        with pytest.raises(DataError, match="in use by another run:"), locked(tmp_path, print):
            pass


def test_a_name_in_the_lock_cannot_command_the_terminal(tmp_path):
    with locked(tmp_path, print):
        (tmp_path / NAME).write_text('{"process": 3, "machine": "a\\u001b[31m", "since": "now"}')
        with pytest.raises(DataError) as refused, locked(tmp_path, print):
            pass
    assert "\x1b" not in str(refused.value)


def test_a_file_system_without_locks_is_told_of_and_used(tmp_path, monkeypatch):
    def none(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", none)
    said = []
    with locked(tmp_path, said.append):
        pass
    assert "knows no locks" in said[0]
    monkeypatch.setattr(lock, "_NO_LOCKS", ())
    with pytest.raises(DataError, match="cannot be locked: No locks available"), locked(tmp_path, said.append):
        pass


def test_a_link_in_place_of_the_lock_is_not_followed(tmp_path):
    other = tmp_path / "precious"
    other.write_text("mine")
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / NAME).symlink_to(other)
    with pytest.raises(DataError, match="a link stands in its place"), locked(tmp_path / "runs", print):
        pass
    assert other.read_text() == "mine"

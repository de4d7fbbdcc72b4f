"""Each test of a command runs in a folder of its own, with a small experiment in it."""

import pytest
from small_experiment import spawn, write_experiment


@pytest.fixture
def empty(tmp_path, monkeypatch):
    """An empty folder to work in; logs of bugs go to another one."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.delenv("COLUMNS", raising=False)
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    return work


@pytest.fixture
def small(empty):
    """A folder with the small experiment as noiseid.yaml."""
    write_experiment(empty)
    return empty


@pytest.fixture
def started():
    """Starts commands as processes of their own, and ends what is left of them."""
    processes = []

    def start(*arguments, **options):
        processes.append(spawn(*arguments, **options))
        return processes[-1]

    yield start
    for process in processes:
        process.kill()
        process.communicate()

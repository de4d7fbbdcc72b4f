"""Runs that are ended from outside: quickly, without a traceback, and to be gone on with."""

import os
import signal
import time
from contextlib import suppress
from pathlib import Path

import pytest
from small_experiment import CONFIG, arrays_of, files_of, noiseid, write_experiment

# From starts so small that EM hardly moves: at rest after thousands of passes only.
RESTLESS = CONFIG.replace("em: {}", "em: {acceleration: none, parameter_tolerance: 0, max_passes: MOST}").replace(
    "scale: [0.1, 10]", "scale: [1e-9, 2e-9]"
)


def wait_for(what, seconds=30.0):
    """Wait until something is true; fail if it never is."""
    end = time.monotonic() + seconds
    while not (found := what()):
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)
    return found


def read_until(process, text, times=1):
    """Read what a command says, until it has said something so often."""
    told = ""
    while told.count(text) < times:
        line = process.stderr.readline()
        assert line, f"it ended before it had said {text!r}: {told}"
        told += line


def processes():
    """Number, parent, state and command line of every process."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has just ended
            # pid (name, which may hold anything) state ppid ...
            state, parent = (folder / "stat").read_text().rpartition(")")[2].split()[:2]
            line = (folder / "cmdline").read_text().replace("\0", " ")
            found.append((int(folder.name), int(parent), state, line))
    return found


def workers_of(process):
    """The worker processes that a command has started."""
    return [pid for pid, parent, _, line in processes() if parent == process.pid and "spawn_main" in line]


def none_alive(workers):
    """Whether all have ended; a process that waits for its parent to take note has."""
    return not any(pid in workers and not state.startswith("Z") for pid, _, state, _ in processes())


def test_a_killed_run_goes_on_where_it_was(empty, started):
    write_experiment(empty, RESTLESS.replace("MOST", "150").replace("samples: 80", "samples: 500\n  replicates: 3"))
    assert noiseid("run", "-q", "-o", "whole").exit_code == 4  # none came to rest
    folder = empty / "runs/small/results"
    process = started("run")
    wait_for(lambda: len(list(folder.glob("*.h5"))) >= 2)
    process.kill()
    assert "Traceback" not in process.communicate()[1]
    before = files_of(folder)
    assert 2 <= len(before) < 6
    again = noiseid("run")
    assert f"estimate: 6 units, {len([n for n in before if n.endswith('.h5')])} there already" in again.stderr
    after = files_of(folder)
    assert {n: t for n, t in before.items() if n.endswith(".h5")}.items() <= after.items()
    assert sorted(after) == sorted(files_of(empty / "whole/small/results"))
    for name in after:
        assert arrays_of(folder / name) == arrays_of(empty / "whole/small/results" / name)


@pytest.mark.parametrize(
    ("number", "jobs", "code"), [(signal.SIGINT, 2, 130), (signal.SIGTERM, 2, 143), (signal.SIGHUP, 1, 129)]
)
def test_a_signal_ends_all_processes_at_once(empty, started, number, jobs, code):
    write_experiment(empty, RESTLESS.replace("MOST", "1000000").replace("samples: 80", "samples: 5000"))
    noiseid("simulate")
    # A group of its own, as a terminal makes one: Ctrl-C reaches the workers too.
    process = started("estimate", "--jobs", str(jobs), "--verbose", start_new_session=True)
    read_until(process, "pass 3,", jobs)
    workers = workers_of(process)
    assert len(workers) == (2 if jobs == 2 else 0)
    began = time.monotonic()
    os.killpg(process.pid, number) if number == signal.SIGINT else process.send_signal(number)
    out, err = process.communicate(timeout=10)
    assert time.monotonic() - began < 3.0
    assert process.returncode == code
    word = "interrupted" if number == signal.SIGINT else f"stopped by {number.name}"
    assert err.splitlines()[-1] == (
        f"noiseid: {word}; what is finished is kept, and the same command goes on from there"
    )
    assert "Traceback" not in err
    assert out == ""
    wait_for(lambda: none_alive(workers), 2.0)
    assert len(list((empty / "runs/small/datasets").glob("*.h5"))) == 1


def test_workers_end_when_their_parent_is_killed(empty, started):
    write_experiment(empty, RESTLESS.replace("MOST", "1000000").replace("samples: 80", "samples: 5000"))
    noiseid("simulate")
    process = started("estimate", "--jobs", "2", "--verbose")
    read_until(process, "pass 3,", 2)
    workers = workers_of(process)
    process.kill()
    process.communicate()
    wait_for(lambda: none_alive(workers), 5.0)


def test_the_unit_of_a_worker_that_is_killed_is_tried_again(empty, started):
    write_experiment(empty, RESTLESS.replace("MOST", "400").replace("samples: 80", "samples: 500"))
    starts = ("--set", "estimate.starts.scale=[1e-9, 2e-9, 3e-9]")
    assert noiseid("run", "-q", "-o", "whole", *starts).exit_code == 4  # none came to rest
    noiseid("simulate")
    process = started("estimate", "--jobs", "2", "--verbose", *starts)
    read_until(process, "pass 3,")
    victim = workers_of(process)[0]
    os.kill(victim, signal.SIGKILL)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 4
    assert err.count("its worker process died; it is tried again.") == 1
    assert "failed" not in err
    folder = empty / "runs/small/results"
    assert len(list(folder.glob("*"))) == 3
    for file in folder.glob("*"):
        assert arrays_of(file) == arrays_of(empty / "whole/small/results" / file.name)

"""Units on a dask cluster: the same bits, whatever happens to its workers."""

import os
import signal
import subprocess
import sys
import threading

import dask
import pytest
from distributed import Future, LocalCluster
from small_experiment import CONFIG, MODEL, arrays_of, noiseid, write_experiment

from noiseid_cli.errors import DataError, MachineError
from noiseid_cli.pipeline.cluster import _cluster_here, check_address
from noiseid_cli.pipeline.context import open_experiment
from noiseid_cli.pipeline.engine import run_units
from noiseid_cli.pipeline.units import dataset_units
from noiseid_cli.pipeline.workers import TRIES, WorkerError
from noiseid_cli.storage.failure_file import read_failure

# distributed leaves sockets to the garbage collector when its workers are killed.
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")


class Record:
    """A listener that keeps what it is told."""

    def __init__(self):
        self.told = []

    def __getattr__(self, name):
        return lambda *what: self.told.append((name, *what))


@pytest.fixture(scope="module")
def cluster():
    """Two workers, and a scheduler that gives up a unit as our own does."""
    settings = {"distributed.scheduler.allowed-failures": TRIES - 1}
    with (
        dask.config.set(settings),
        LocalCluster(
            n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0", silence_logs=50
        ) as cluster,
    ):
        yield cluster


def files(folder):
    return {path.name: path for path in (folder / "small").rglob("*.h5")}


def differing(one, other):
    """Which arrays of which files are not equal to the last bit."""
    found = []
    for name in other:
        a, b = arrays_of(one[name]), arrays_of(other[name])
        found += [f"{name}: {key}" for key in sorted(a.keys() | b.keys()) if a.get(key) != b.get(key)]
    return found


def test_the_same_bits_as_with_one_process_while_workers_die(tmp_path, cluster, monkeypatch):
    monkeypatch.chdir(tmp_path)
    more = "sweep:\n  axes:\n    noise: {vary: simulate.process_noise.std.0, values: [0.5, 1.0, 2.0]}\n"
    file = write_experiment(tmp_path, CONFIG + more)
    assert noiseid("run", file.name, "-q", "-o", "one").exit_code == 0

    def kill():
        os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)

    for seconds in (1.0, 3.0):
        threading.Timer(seconds, kill).start()
    ran = noiseid("run", file.name, "-o", "many", "--dask", cluster.scheduler_address)  # a relative folder
    assert ran.exit_code == 0, ran.stderr
    one, many = files(tmp_path / "one"), files(tmp_path / "many")
    assert len(one) == 9
    assert sorted(many) == sorted(one)
    assert all(arrays_of(many[name]) == arrays_of(one[name]) for name in one)
    assert not list((tmp_path / "many").rglob("*.part"))
    again = noiseid("run", file.name, "-o", "many", "--dask", cluster.scheduler_address)
    assert "estimate: 6 units, all there already" in again.stderr


POISON = """
import os
if os.getpid() != PARENT:
    import noiseid_cli.pipeline.datasets as d
    real = d.make_dataset
    def make(context, unit):
        if unit.replicate == 1:
            FAULT
        return real(context, unit)
    d.make_dataset = make
"""


def poisoned(folder, fault, replicates=3):
    file = write_experiment(folder)
    code = POISON.replace("PARENT", str(os.getpid())).replace("FAULT", fault)
    (folder / "cart.py").write_text(MODEL + code)
    context = open_experiment(file, folder, [f"simulate.replicates={replicates}"])
    return context, dataset_units(context)


def test_a_unit_that_kills_its_worker_is_given_up_after_three_tries(tmp_path, cluster):
    context, units = poisoned(tmp_path, "os.kill(os.getpid(), 9)")
    tokens = run_units(context, "simulate", units, Record(), dask=cluster.scheduler_address)
    assert [token.state for token in tokens] == ["made", "failed", "made"]
    assert tokens[1].message.startswith(f"its worker died {TRIES} times")
    assert read_failure(units[1].path).tries == TRIES
    assert [token.path for token in tokens] == [unit.path for unit in units]


def test_what_a_unit_told_is_lost_with_its_worker(tmp_path, cluster, monkeypatch):
    file = write_experiment(tmp_path)
    context = open_experiment(file, tmp_path, ["simulate.replicates=3"])
    fetch, fetched = Future.result, []

    def result(future, timeout):
        fetched.append(future.key)
        if len(fetched) == 1:
            for nanny in cluster.workers.values():
                if nanny.pid:  # or the last test killed it and it starts again
                    os.kill(nanny.pid, signal.SIGKILL)
            raise TimeoutError
        return fetch(future, timeout)

    monkeypatch.setattr(Future, "result", result)
    tokens = run_units(context, "simulate", dataset_units(context), Record(), dask=cluster.scheduler_address)
    assert [token.state for token in tokens] == ["made"] * 3
    assert fetched[0] in fetched[1:]


def test_an_error_on_a_worker_is_a_token_and_a_bug_is_reported(tmp_path, cluster):
    (tmp_path / "a").mkdir()
    context, units = poisoned(tmp_path / "a", "from noiseid_cli.errors import DataError; raise DataError('it rained')")
    tokens = run_units(context, "simulate", units, Record(), dask=cluster.scheduler_address)
    assert [token.message for token in tokens][1] == "it rained"
    (tmp_path / "b").mkdir()
    context, units = poisoned(tmp_path / "b", "1 / 0")
    with pytest.raises(WorkerError, match="ZeroDivisionError"):
        run_units(context, "simulate", units, Record(), dask=cluster.scheduler_address)
    (tmp_path / "c").mkdir()
    context, units = poisoned(tmp_path / "c", "raise OSError(122, 'Disk quota exceeded', 'x.h5')")
    with pytest.raises(MachineError, match=r"^x\.h5 could not be .*: Disk quota exceeded: the disk quota is used up"):
        run_units(context, "simulate", units, Record(), dask=cluster.scheduler_address)


ALONE = """
from distributed import LocalCluster
address = {"host": "127.0.0.1", "protocol": "tcp", "dashboard_address": "127.0.0.1:0"}
with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, silence_logs=50, **address) as cluster:
    print(cluster.scheduler_address, flush=True)
    input()
"""


def test_a_scheduler_that_dies_in_mid_run_loses_nothing_that_is_finished(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    restless = "em: {acceleration: none, parameter_tolerance: 0, max_passes: 30}"
    write_experiment(
        tmp_path, CONFIG.replace("em: {}", restless).replace("samples: 80", "samples: 200\n  replicates: 3")
    )
    assert noiseid("run", "-q", "-o", "whole").exit_code == 4  # none comes to rest
    # Scheduler and worker in one process, which is killed when the second result is there.
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", ALONE], text=True, **pipes) as alone:
        results, ended = tmp_path / "runs/small/results", threading.Event()

        def watch():
            while len(list(results.glob("*.h5"))) < 2 and not ended.wait(0.01):
                pass
            alone.kill()

        watcher = threading.Thread(target=watch)
        watcher.start()
        try:
            told = noiseid("run", "--dask", alone.stdout.readline().strip())
        finally:
            ended.set()
            watcher.join()
    assert told.exit_code == 1
    assert told.stderr.splitlines()[-1] == (
        "noiseid: the connection to the dask scheduler was lost; what is finished is kept, and the same command goes "
        "on from there"
    )
    assert "Traceback" not in told.stderr + capfd.readouterr().err
    kept = {path: path.stat().st_mtime_ns for path in files(tmp_path / "runs").values()}
    assert 5 <= len(kept) < 9
    again = noiseid("run")
    assert again.exit_code == 4
    assert f"estimate: 6 units, {len(kept) - 3} there already" in again.stderr
    whole, now = files(tmp_path / "whole"), files(tmp_path / "runs")
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert sorted(now) == sorted(whole)
    assert differing(now, whole) == []


@pytest.mark.parametrize("address", ["nowhere", "http://a:1", "tcp://a", "tls://", "/etc", "tcp://a:1/../x"])
def test_what_is_no_address_is_refused_before_anything_is_made(tmp_path, address):
    with pytest.raises(DataError, match="give the address of a dask scheduler"):
        check_address(address)
    refused = noiseid("run", write_experiment(tmp_path), "--dask", address, "-o", tmp_path / "runs")
    assert refused.exit_code == 3
    assert not (tmp_path / "runs").exists()


def test_a_scheduler_that_is_not_there_is_told_of(tmp_path, monkeypatch):
    monkeypatch.setattr("noiseid_cli.pipeline.cluster._PATIENCE", 0.5)
    refused = noiseid("simulate", write_experiment(tmp_path), "--dask", "tcp://127.0.0.1:9", "-o", tmp_path / "runs")
    assert refused.exit_code == 3
    assert "no dask scheduler answers at tcp://127.0.0.1:9" in refused.stderr


def test_workers_that_die_while_they_start_are_started_again(monkeypatch):
    """Dask gives the whole cluster up when one worker dies before it is at work."""
    fates = ["dies", "dies", "lives"]

    def start(**options):
        if fates.pop(0) == "dies":
            raise RuntimeError("Nanny failed to start.")
        return options

    monkeypatch.setattr("distributed.LocalCluster", start)
    started = _cluster_here(3)
    assert (started["n_workers"], started["host"], started["dashboard_address"]) == (3, "127.0.0.1", "127.0.0.1:0")
    fates[:] = ["dies"] * TRIES
    with pytest.raises(MachineError, match=f"workers of --dask local died {TRIES} times while they started"):
        _cluster_here(1)
    assert not fates


def test_local_makes_workers_of_its_own_on_this_machine_only(tmp_path):
    file = write_experiment(tmp_path)
    ran = noiseid("simulate", file, "--dask", "local", "-j", "1", "-o", tmp_path / "runs")
    assert ran.exit_code == 0, ran.stderr
    assert len(files(tmp_path / "runs")) == 1

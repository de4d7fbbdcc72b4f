"""Units are run here or in worker processes; what goes wrong in one is told and stays there."""

import importlib.util
import re
import sys
import time
from pathlib import Path

import pytest
from small_experiment import CONFIG, MODEL, arrays_of

from noiseid_cli.errors import DataError, MachineError
from noiseid_cli.pipeline import datasets
from noiseid_cli.pipeline.context import open_experiment
from noiseid_cli.pipeline.engine import run_units
from noiseid_cli.pipeline.kernels import SENTENCE, Compiled, kernels_announced
from noiseid_cli.pipeline.making import Token
from noiseid_cli.pipeline.units import dataset_units, estimate_units
from noiseid_cli.pipeline.wording import counted
from noiseid_cli.pipeline.workers import TRIES, WorkerError
from noiseid_cli.storage.failure_file import read_failure


class Record:
    """A listener that keeps what it is told."""

    def __init__(self):
        self.told = []

    def __getattr__(self, name):
        return lambda *what: self.told.append((name, *what))

    def of(self, kind):
        return [what for name, *what in self.told if name == kind]


def opened(file, *overrides):
    return open_experiment(file, file.parent / "runs", overrides)


def test_a_listener_hears_every_unit_in_order(small):
    context, record = opened(small), Record()
    run_units(context, "simulate", dataset_units(context), record)
    units = estimate_units(context)
    tokens = run_units(context, "estimate", units, record)
    assert record.of("stage") == [["simulate", 1, 0], ["estimate", 2, 0]]
    names = ["replicate-000", "replicate-000/em/start-0", "replicate-000/em/start-1"]
    assert record.of("begin") == [[name] for name in names]
    assert [token.unit for (token,) in record.of("end")] == names
    passes = [(unit, k) for unit, k, _ in record.of("passed")]
    assert passes[:2] == [(names[1], 1), (names[1], 2)]
    assert [t.state for t in tokens] == ["made", "made"]
    assert [t.status for t in tokens] == ["converged", "converged"]
    assert tokens[0].message.startswith("converged after ")
    again = run_units(context, "estimate", units, record)
    assert [(t.state, t.status) for t in again] == [("there", "converged")] * 2
    assert [t.state for t in run_units(context, "estimate", units, record, force=True)] == ["made"] * 2


def test_a_token_knows_what_is_unfinished():
    assert not Token("a", Path("a"), "made", status="converged").unfinished
    assert not Token("a", Path("a"), "made").unfinished
    assert Token("a", Path("a"), "there", status="max_passes").unfinished


def test_a_failed_unit_is_a_token_and_the_others_go_on(small, monkeypatch):
    context, record = opened(small, "simulate.replicates=3"), Record()

    def faulty(context, unit):
        if unit.replicate == 1:
            raise DataError("it rained")
        return real(context, unit)

    from noiseid_cli.pipeline import datasets

    real = datasets.make_dataset
    monkeypatch.setattr(datasets, "make_dataset", faulty)
    tokens = run_units(context, "simulate", dataset_units(context), record)
    assert [t.state for t in tokens] == ["made", "failed", "made"]
    assert tokens[1].message == "it rained"
    units = dataset_units(context)
    assert [u.done for u in units] == [True, False, True]
    assert read_failure(units[1].path).reason == "it rained"
    monkeypatch.undo()
    assert [t.state for t in run_units(context, "simulate", units, record)] == ["there", "made", "there"]
    assert read_failure(units[1].path) is None


def test_a_unit_without_enough_memory_fails_and_the_others_go_on(small, monkeypatch):
    real = datasets.make_dataset

    def large(context, unit):
        if unit.replicate == 1:
            raise MemoryError
        return real(context, unit)

    monkeypatch.setattr(datasets, "make_dataset", large)
    context = opened(small, "simulate.replicates=3")
    tokens = run_units(context, "simulate", dataset_units(context), Record())
    assert [t.state for t in tokens] == ["made", "failed", "made"]
    assert tokens[1].message.startswith("there is not enough memory: take fewer samples")


def test_a_failure_that_cannot_be_recorded_does_not_end_the_run(small, monkeypatch):
    from noiseid_cli.pipeline import datasets
    from noiseid_cli.storage import failure_file

    def refused(*_):
        raise DataError("writing is not permitted")

    monkeypatch.setattr(datasets, "make_dataset", refused)
    monkeypatch.setattr(failure_file, "publish", refused)
    context = opened(small, "simulate.replicates=2")
    tokens = run_units(context, "simulate", dataset_units(context), Record())
    assert [t.message for t in tokens] == ["writing is not permitted"] * 2


def test_a_unit_whose_worker_dies_once_is_tried_again(small):
    # The first worker leaves a mark and dies; the next one finds the mark.
    code = "mark = __file__ + '.mark'\n    if not os.path.exists(mark):\n        open(mark, 'x').close(); os._exit(3)\n"
    (small.parent / "cart.py").write_text(MODEL + IN_A_WORKER + code)
    context, record = opened(small, "simulate.replicates=2"), Record()
    tokens = run_units(context, "simulate", dataset_units(context), record, jobs=2)
    assert [t.state for t in tokens] == ["made"] * 2
    again = [sentence for (sentence,) in record.of("say") if sentence.endswith("died; it is tried again.")]
    assert again[0].startswith("replicate-00")


IN_A_WORKER = "\nimport multiprocessing, os\nif multiprocessing.parent_process() is not None:\n    "


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("os._exit(3)", "its worker process died 3 times, the last time with exit code 3 "),
        ("raise ValueError('no')", "ValueError: no"),
        ("Cart.parameters = (*Cart.parameters, Parameter('z', 1.0))", "was changed while this run started"),
    ],
)
def test_workers_that_cannot_begin_fail_their_units(small, code, message):
    (small.parent / "cart.py").write_text(MODEL + IN_A_WORKER + code + "\n")
    context, record = opened(small, "simulate.replicates=3"), Record()
    tokens = run_units(context, "simulate", dataset_units(context), record, jobs=2)
    assert [t.state for t in tokens] == ["failed"] * 3
    assert all(message in t.message for t in tokens)
    assert [t.tries for t in tokens] == [TRIES if "died" in message else 1] * 3
    assert [read_failure(t.path).tries for t in tokens] == [t.tries for t in tokens]
    assert sorted(token.unit for (token,) in record.of("end")) == [t.unit for t in tokens]


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_full_disk_ends_the_run_at_once(small, jobs):
    """The units after it would fail as well, perhaps after hours; none of them has a record of a failure."""
    full = "import noiseid_cli.pipeline.datasets as d\nreal = d.make_dataset\n"
    full += "def make(c, u):\n    if u.replicate == 1:\n        raise OSError(28, 'No space left on device')\n"
    full += "    return real(c, u)\nd.make_dataset = make\n"
    if jobs == 2:
        full = IN_A_WORKER + full.replace("\n", "\n    ")
    (small.parent / "cart.py").write_text(MODEL + "\n" + full)
    real = datasets.make_dataset
    try:
        context = opened(small, "simulate.replicates=3")
        units = dataset_units(context)
        with pytest.raises(MachineError, match="No space left on device: the disk is full"):
            run_units(context, "simulate", units, Record(), jobs=jobs)
    finally:
        datasets.make_dataset = real
    assert not units[1].done
    assert all(read_failure(unit.path) is None for unit in units)


def test_a_unit_that_hangs_is_ended_and_the_others_go_on(small):
    hang = "import noiseid_cli.pipeline.datasets as d, time\n    real = d.make_dataset\n"
    hang += "    d.make_dataset = lambda c, u: time.sleep(600) if u.replicate == 1 else real(c, u)\n"
    (small.parent / "cart.py").write_text(MODEL + IN_A_WORKER + hang)
    context, record = opened(small, "simulate.replicates=3"), Record()
    units = dataset_units(context)
    began = time.monotonic()
    tokens = run_units(context, "simulate", units, record, time_limit=12.0)  # one process is enough for a limit
    assert [t.state for t in tokens] == ["made", "failed", "made"]
    assert time.monotonic() - began < 120.0
    assert "ended after 12 s, the limit of --unit-timeout" in tokens[1].message
    assert tokens[1].tries == read_failure(units[1].path).tries == 1
    assert "12 s" in read_failure(units[1].path).reason


def test_a_time_limit_does_not_go_with_dask(small):
    context = opened(small)
    with pytest.raises(DataError, match="--unit-timeout is for processes of this machine"):
        run_units(context, "simulate", dataset_units(context), Record(), dask="local", time_limit=1.0)


def test_where_nothing_is_compiled_yet_the_first_worker_goes_ahead(small, tmp_path, monkeypatch):
    """Only the first unit's process may run until it is made; then it is noted, and all start at once."""
    monkeypatch.setenv("NOISEID_CACHE_DIR", str(tmp_path / "cache"))
    context = opened(small, "simulate.replicates=3")
    units, first, second = dataset_units(context), Record(), Record()
    assert not Compiled(context, units).known
    assert [t.state for t in run_units(context, "simulate", units, first, jobs=2)] == ["made"] * 3
    told = [name for name, *_ in first.told if name in ("begin", "end")]
    assert told[:2] == ["begin", "end"]
    assert Compiled(context, units).known
    assert not Compiled(opened(small, "model.parameters={k: 1}"), units).known
    run_units(context, "simulate", units, second, jobs=2, force=True)
    assert second.of("begin")[0] != second.of("begin")[1]


def test_a_damaged_file_is_put_aside_and_made_anew(small):
    context, record = opened(small), Record()
    (unit,) = units = dataset_units(context)
    run_units(context, "simulate", units, record)
    whole = unit.path.read_bytes()
    aside = unit.path.with_name(f"{unit.path.name}.damaged")
    for damaged, name in ((whole[:-1], aside), (b"", aside.with_name(f"{aside.name}-2"))):
        unit.path.write_bytes(damaged)
        (token,) = run_units(context, "simulate", units, record)
        assert token.state == "made"
        assert name.read_bytes() == damaged
        assert record.of("say")[-1][0].endswith(f"It is kept as {name.name}.")
        assert arrays_of(unit.path)["y"] == arrays_of(aside.with_name(unit.path.name))["y"]
        assert [t.state for t in run_units(context, "simulate", units, record)] == ["there"]


def test_a_damaged_file_that_cannot_be_moved_is_told(small, monkeypatch):
    from noiseid_cli.storage import atomic

    context = opened(small)
    (unit,) = units = dataset_units(context)
    run_units(context, "simulate", units, Record())
    unit.path.write_bytes(b"")

    def refused(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(atomic.Path, "rename", refused)
    with pytest.raises(DataError, match="could not be put aside: Permission denied"):
        run_units(context, "simulate", units, Record())
    assert unit.path.exists()


def test_a_file_of_a_newer_noiseid_is_not_moved(small, monkeypatch):
    from noiseid_cli.storage import result_file

    context = opened(small)
    run_units(context, "simulate", dataset_units(context), Record())
    units = estimate_units(context)[:1]
    with monkeypatch.context() as newer:
        newer.setattr(result_file, "VERSION", 999)
        run_units(context, "estimate", units, Record())
    (token,) = run_units(context, "estimate", units, Record())
    assert token.state == "failed"
    assert "999" in token.message
    assert units[0].path.exists()


def test_a_bug_in_a_worker_is_reported_with_its_traceback(small):
    code = "import noiseid_cli.pipeline.datasets as d\n    d.make_dataset = lambda *_: 1 / 0\n"
    (small.parent / "cart.py").write_text(MODEL + IN_A_WORKER + code)
    context = opened(small, "simulate.replicates=2")
    with pytest.raises(WorkerError, match="ZeroDivisionError: division by zero") as bug:
        run_units(context, "simulate", dataset_units(context), Record(), jobs=2)
    assert str(bug.value).startswith("Traceback")


def test_workers_tell_what_goes_on(small):
    small.write_text(CONFIG.replace("samples: 80", "samples: 80\n  replicates: 2"))
    context, record = opened(small), Record()
    tokens = run_units(context, "simulate", dataset_units(context), record, jobs=2)
    assert [t.state for t in tokens] == ["made"] * 2
    assert sorted(record.of("begin")) == [["replicate-000"], ["replicate-001"]]
    assert record.of("stage") == [["simulate", 2, 0]]


def test_compilation_is_announced_unless_the_cache_holds_it(tmp_path, monkeypatch):
    file = tmp_path / "fake_kernel.py"
    file.write_text("from numba import njit\n\n\n@njit(cache=CACHE)\ndef twice(x):\n    return 2 * x\n")
    source = file.read_text()

    def announced(name, cache):
        file.write_text(source.replace("CACHE", str(cache)))
        spec = importlib.util.spec_from_file_location(name, file)
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        said, waited = [], []
        try:
            spec.loader.exec_module(module)
            with kernels_announced(said.append, lambda count, kernel: waited.append((count, kernel))):
                assert module.twice(3) == 6
                assert module.twice(3.5) == 7.0
        finally:
            del sys.modules[name]
        return said, waited

    said, waited = announced("noiseid_cli.fake_kernel", True)
    assert said[0] == SENTENCE
    assert re.fullmatch(r"2 kernels compiled in \d+ s, and kept\.", said[1])
    assert waited == [(1, "fake_kernel.twice"), (2, "fake_kernel.twice")]
    monkeypatch.setattr("noiseid_cli.models.cache._unkept", ["Compiled kernels cannot be kept in x."])
    source += "\n\n# it is another file now\n"
    said, _ = announced("noiseid_cli.fake_kernel", True)
    assert re.fullmatch(r"2 kernels compiled in \d+ s\.", said[1])
    assert said[2:] == ["Compiled kernels cannot be kept in x."]
    monkeypatch.undo()
    assert announced("fake_kernel", True) == ([], [])  # a model's own functions are announced elsewhere
    assert announced("noiseid_cli.fake_kernel", False) == ([], [])  # compiled each time, and part of something else


def test_counted_words():
    assert [counted(n, "unit") for n in (0, 1, 2)] == ["0 units", "1 unit", "2 units"]
    assert counted(2, "pass", "passes") == "2 passes"

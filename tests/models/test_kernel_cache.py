"""Where compiled kernels are kept, and what is imported before anything is asked for."""

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from noiseid_cli.errors import MachineError, ModelError
from noiseid_cli.models.cache import cache_root, kernel_folder, unkept

HEAVY = {"numpy", "scipy", "numba", "sympy", "matplotlib", "h5py", "pydantic", "rich", "yaml", "jinja2", "platformdirs"}


@pytest.fixture
def places(tmp_path, monkeypatch):
    """A package that cannot be written (a file stands where its folder should be), and a cache folder."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("NOISEID_CACHE_DIR", str(tmp_path / "cache"))
    (tmp_path / "package").write_text("")
    return tmp_path


def test_kernels_stand_beside_the_source_where_that_can_be_written(places):
    assert kernel_folder(places) is None


def test_kernels_of_a_read_only_installation_go_to_the_cache_folder(places, monkeypatch):
    assert kernel_folder(places / "package") == places / "cache" / "kernels"
    assert cache_root() == places / "cache"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(places / "mine"))
    assert kernel_folder(places / "package") is None
    assert (places / "mine").is_dir()


def test_without_any_folder_the_user_is_told_what_to_set(places, monkeypatch):
    monkeypatch.setenv("NOISEID_CACHE_DIR", str(places / "package"))
    with pytest.raises(ModelError, match="set NOISEID_CACHE_DIR to a folder"):
        kernel_folder(places / "package")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(places / "package"))
    with pytest.raises(ModelError, match=r"cannot be kept in .*/package: .*; set NUMBA_CACHE_DIR to another folder\."):
        kernel_folder(places)


@pytest.mark.parametrize("variable", ["NOISEID_CACHE_DIR", "NUMBA_CACHE_DIR"])
def test_a_full_disk_is_told_as_such(places, monkeypatch, variable):
    def full(**_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tempfile.TemporaryFile", full)
    monkeypatch.setenv(variable, str(places / "full"))
    with pytest.raises(
        MachineError, match=rf"/full.* \(set {variable} to .*\): No space left on device: the disk is full"
    ):
        kernel_folder(places)


def test_a_function_is_used_though_the_disk_is_too_full_to_keep_it(places, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    source = "from numba import float64\nfrom noiseid_cli.models.jit import equation, kernel\n"
    for decorator in ("kernel", "equation"):
        source += f"\n\n@{decorator}(float64(float64))\ndef {decorator}_twice(x):\n    return 2.0 * x\n"
    (places / "two.py").write_text(source)
    monkeypatch.setattr("noiseid_cli.models.cache._unkept", [])
    monkeypatch.setattr("numba.core.caching.IndexDataCacheFile.save", full)
    spec = importlib.util.spec_from_file_location("noiseid_cli.two", places / "two.py")
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "noiseid_cli.two", module)
    assert unkept() == ""
    spec.loader.exec_module(module)
    assert unkept() == (
        f"Compiled kernels cannot be kept in {places / '__pycache__'} (No space left on device), so that the next run "
        "compiles them again; NUMBA_CACHE_DIR takes another folder."
    )
    monkeypatch.setattr("noiseid_cli.models.cache._unkept", [])
    assert module.kernel_twice(3.0) == module.equation_twice(3.0) == 6.0
    assert str(places) in unkept()


def test_a_kernel_is_compiled_when_it_is_called_and_found_again(places):
    """By two processes that start together, where the package cannot be written; a third compiles nothing."""
    script = (
        "import sys\n"
        "import numba\n"  # before anybody has said where kernels go
        "from pathlib import Path\n"
        "from noiseid_cli.models.cache import place_kernels\n"
        "place_kernels(Path(sys.argv[1]))\n"
        "sys.path.insert(0, sys.argv[2])\n"
        "from one import twice\n"
        "print(len(twice.overloads), twice(2.0), twice(3), *map(str, twice.signatures))\n"
        "print(sum(twice.stats.cache_hits.values()))\n"
    )
    (places / "one.py").write_text(
        "from numba import float64\nfrom noiseid_cli.models.jit import kernel\n\n\n"
        "@kernel(float64(float64))\ndef twice(x):\n    return 2.0 * x\n"
    )
    run = [sys.executable, "-c", script, str(places / "package"), str(places)]
    both = [subprocess.Popen(run, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    # Nothing before the first call; then the declared signature only, whatever it is called with.
    said = "0 4.0 6.0 (float64,)\n"
    for process in both:
        assert process.communicate(timeout=60)[0] in (said + "0\n", said + "1\n")
    assert subprocess.run(run, capture_output=True, text=True, check=True).stdout == said + "1\n"
    assert list((places / "cache" / "kernels").rglob("*.nbc"))


CALLED = """
from typing import NamedTuple
from noiseid_cli.models.jit import routine

FACTOR = 2.0
FACTORS = (1.0, 5.0)


class Pair(NamedTuple):
    a: float
    b: float


@routine
def scale(x):
    pair = Pair(x, x)
    return FACTOR * pair.a
"""
CALLING = """
from numba import float64
from called import scale
from noiseid_cli.models.jit import equation, kernel


@kernel(float64(float64))
def kept(x):
    return scale(x)


@equation(float64(float64))
def made_at_once(x):
    return scale(x)
"""


@pytest.mark.parametrize(
    ("old", "new", "result"),
    [
        ("", "", 6.0),
        ("    pair", '    """Twice."""\n    # or so\n    pair', 6.0),
        ("FACTORS = (1.0, 5.0)", "FACTORS = (1.0, 6.0)", 6.0),  # which no function reads
        ("FACTOR = 2.0", "FACTOR = 3.0", 9.0),
        ("FACTOR = 2.0", "import numpy as np\nFACTOR = np.float64(3.0)", 9.0),
        ("return FACTOR * pair.a", "return FACTORS[1] * pair.b", 15.0),
        ("return FACTOR *", "return FACTOR +", 5.0),
    ],
)
def test_a_function_is_compiled_again_where_what_it_calls_has_changed_and_only_there(tmp_path, old, new, result):
    """In another file, which numba does not look at; the time stamp of the function's own file says nothing."""

    def run():
        script = "from calling import *; print(kept(3.0), made_at_once(3.0), len(kept.stats.cache_hits))"
        environment = os.environ | {
            "PYTHONPATH": os.pathsep.join((str(tmp_path), *sys.path)),
            "PYTHONHASHSEED": "random",
        }
        done = subprocess.run(
            [sys.executable, "-c", script], capture_output=True, text=True, check=True, env=environment
        )
        return done.stdout.split()

    (tmp_path / "called.py").write_text(CALLED)
    (tmp_path / "calling.py").write_text(CALLING)
    assert run() == ["6.0", "6.0", "0"]
    assert CALLED.replace(old, new) != CALLED or old == new
    (tmp_path / "called.py").write_text(CALLED.replace(old, new))
    os.utime(tmp_path / "calling.py")
    assert run() == [str(result), str(result), "1" if result == 6.0 else "0"]


def imported_by(*arguments):
    """Top-level packages that a command imports."""
    script = (
        "import sys, json\n"
        "from noiseid_cli.app import main\n"
        "try:\n    main()\nexcept SystemExit:\n    pass\n"
        "print(json.dumps(sorted({name.partition('.')[0] for name in sys.modules})), file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=True)
    return set(json.loads(done.stderr.splitlines()[-1]))


@pytest.mark.parametrize("arguments", [["--version"], ["--help"], ["run", "--help"]])
def test_what_only_talks_imports_nothing_heavy(arguments):
    allowed = set() if arguments == ["--version"] else {"rich", "pydantic"}  # typer takes them for help
    assert imported_by(*arguments) & HEAVY <= allowed


@pytest.mark.parametrize("config", ["quickstart", "local_level"])
def test_checking_an_experiment_draws_and_compiles_nothing(tmp_path, config):
    file = Path(__file__).parents[2] / "configs" / f"{config}.yaml"
    imported = imported_by("check", str(file), "--out", str(tmp_path))
    assert not imported & {"matplotlib", "jinja2", "numba", "scipy"}
    assert ("sympy" in imported) == (config == "quickstart")  # constant matrices are no equations


def test_the_garbage_collector_keeps_out_of_the_way_of_a_command():
    """Searching all that was imported, over and over and once more at the end, was a quarter of a short run."""
    show = "print(gc.get_threshold()[0], gc.get_freeze_count() > 10_000)"
    script = f"import gc\nfrom noiseid_cli.app import main\ntry:\n    main()\nfinally:\n    {show}\n"
    done = subprocess.run([sys.executable, "-c", script, "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "10000 True"

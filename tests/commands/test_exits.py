"""How commands end: exit codes, error texts, logs, and what is never on the screen."""

import contextlib
import json
import resource
import subprocess
import sys

import pytest
from small_experiment import COMMAND, CONFIG, files_of, noiseid, write_experiment

from noiseid_cli import __version__
from noiseid_cli.commands import console
from noiseid_cli.errors import DataError

HEAVY = ("numpy", "scipy", "sympy", "numba", "matplotlib", "h5py", "pydantic", "yaml", "jinja2", "rich", "platformdirs")


def used_by_children():
    """Seconds of a processor; a clock would tell how busy the machine is."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def test_version_is_quick_and_imports_nothing_heavy():
    seconds = []
    for _ in range(3):
        began = used_by_children()
        told = subprocess.run([*COMMAND, "--version"], capture_output=True, text=True, check=True)
        seconds.append(used_by_children() - began)
    assert told.stdout == f"noiseid {__version__}\n"
    assert min(seconds) < 0.5
    code = f"import sys, noiseid_cli.app; print([m for m in {HEAVY} if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


def test_six_mistakes_are_told_at_once_with_their_places(small):
    bad = CONFIG.replace("seed: 7", "sede: 7").replace("samples: 80", "samples: 1").replace("std: [0.5]", "std: [-0.5]")
    bad = bad.replace("kind: multisine", "kind: multisin").replace("{known: truth}", "{known: yes}")
    write_experiment(small, bad.replace("em: {}", "em: {max_passes: 1.5}"))
    before = files_of(small)
    for command in ("check", "run", "simulate", "estimate", "report", "cite"):
        result = noiseid(command)
        assert result.exit_code == 3
        assert "Traceback" not in result.stderr
        assert result.stdout == ""
        lines = result.stderr.splitlines()
        assert lines[-1] == "noiseid: 6 mistakes in noiseid.yaml; nothing was done"
        places = [line.split(": ")[:2] for line in lines if line.startswith("noiseid.yaml:")]
        assert places == [
            ["noiseid.yaml:2:1", "sede"],
            ["noiseid.yaml:5:12", "simulate.samples"],
            ["noiseid.yaml:6:22", "simulate.trajectory.kind"],
            ["noiseid.yaml:7:25", "simulate.process_noise.std.0"],
            ["noiseid.yaml:12:25", "estimate.initial_mean.known"],
            ["noiseid.yaml:16:22", "estimate.methods.em.max_passes"],
        ]
        # The line itself stands below, with a mark under the place.
        at = lines.index(next(line for line in lines if line.startswith("noiseid.yaml:5:12")))
        assert lines[at + 1 : at + 3] == ["      samples: 1", "    " + " " * 11 + "^"]
    assert files_of(small) == before


def test_names_are_checked_against_the_model(small):
    write_experiment(small, CONFIG.replace("start: {std: [1]}", "start: {std: [1, 2]}"))
    result = noiseid("check")
    assert result.exit_code == 3
    assert "estimate.process_noise.start.std: has 2 entries, but the model has 1 process noise: v" in result.stderr
    assert "noiseid: a mistake in noiseid.yaml; nothing was done" in result.stderr.splitlines()
    write_experiment(small, CONFIG.replace("class: Cart", "class: Kart"))
    assert "there is no model class Kart; it defines Cart" in noiseid("check").stderr


@pytest.mark.parametrize(
    "words", [("--nosuch",), ("nosuch",), ("run", "--nosuch"), ("run", "--jobs", "0"), ("inspect",)]
)
def test_wrong_usage_ends_with_2(empty, words):
    result = noiseid(*words)
    assert result.exit_code == 2
    assert result.stderr.startswith("Usage: ")


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("run", "missing.yaml"), "missing.yaml: there is no such file"),
        (("check", "."), ".: is a folder; the experiment must be a YAML file"),
        (("inspect", "missing.h5"), "missing.h5 does not exist; expected a noiseid file. Check the name."),
        (("models", "show", "no_robot"), "model no_robot is not known; known: "),
        (("models", "show", "no.py:A"), "no.py: no such model file."),
        (("models", "show", "cart.py"), "cart.py may hold several models: name the class too, as cart.py:CLASS"),
        (("init",), "noiseid.yaml is there already: give another name, or --force to replace it"),
        (("run", "-o", "cart.py"), "a file stands where a folder is needed; choose another folder."),
        (("report",), "there are no results of this experiment under runs/small: run `noiseid estimate` first"),
        (("run", "--set", "simulate"), "must be of the form PATH=VALUE, such as simulate.samples=500"),
    ],
)
def test_what_the_user_can_mend_ends_with_3_and_a_sentence(small, words, sentence):
    result = noiseid(*words)
    assert result.exit_code == 3
    assert sentence in result.stderr
    assert "Traceback" not in result.stderr


def test_a_report_that_cannot_be_written_is_told_in_a_sentence(small):
    noiseid("run")
    page = small / "runs/small/report/report.md"
    page.unlink()
    page.mkdir()
    result = noiseid("run")
    assert result.exit_code == 3
    assert result.stderr.splitlines()[-1].startswith(
        "noiseid: the report cannot be written: runs/small/report/report.md"
    )


def test_a_bug_is_one_line_and_a_traceback_in_a_log(small, monkeypatch):
    def broken(*_):
        raise RuntimeError("the wheel came off")

    monkeypatch.setattr("noiseid_cli.pipeline.datasets.make_dataset", broken)
    result = noiseid("run")
    assert result.exit_code == 1
    last = result.stderr.splitlines()[-1]
    assert last.startswith("noiseid: internal error: RuntimeError: the wheel came off; please report it with ")
    assert "Traceback" not in result.stderr
    (log,) = (small.parent / "state").rglob("error-*.log")
    assert last.endswith(str(log))
    assert "in broken\n" in log.read_text()
    # Where no log can be kept, a temporary one is.
    (small.parent / "state2").write_text("")
    monkeypatch.setenv("XDG_STATE_HOME", str(small.parent / "state2"))
    monkeypatch.setattr("tempfile.tempdir", str(small))
    assert noiseid("run").exit_code == 1
    assert len(list(small.glob("noiseid-error-*.log"))) == 1


@pytest.mark.parametrize(
    ("stop", "code", "words"),
    [
        (KeyboardInterrupt(), 130, "interrupted"),
        (console.Stopped(15), 143, "stopped by SIGTERM"),
    ],
)
def test_an_interrupted_command_says_that_it_can_go_on(small, monkeypatch, stop, code, words):
    def interrupted(*_):
        raise stop

    monkeypatch.setattr("noiseid_cli.pipeline.estimation.make_estimate", interrupted)
    result = noiseid("run")
    assert result.exit_code == code
    assert result.stderr.splitlines()[-1] == (
        f"noiseid: {words}; what is finished is kept, and the same command goes on from there"
    )
    monkeypatch.undo()


def test_a_reader_that_leaves_early_is_no_error(started):
    process = started("schema")
    process.stdout.close()
    with contextlib.suppress(ValueError):
        assert process.stderr.read() == ""
    assert process.wait() == 0


def test_a_terminal_that_lacks_letters_gets_question_marks(small, monkeypatch):
    noiseid("run")
    monkeypatch.setenv("PYTHONIOENCODING", "latin-1")
    told = subprocess.run([*COMMAND, "run"], capture_output=True, check=True)
    assert b"\n??????????????" in told.stdout  # the rule under a heading
    assert "× 0.1".encode("latin-1") in told.stdout


def test_the_same_failure_of_many_units_is_explained_once(capsys):
    from pathlib import Path

    from noiseid_cli.commands.progress import PlainListener, QuietListener
    from noiseid_cli.pipeline.making import Token

    for listener in (QuietListener(), PlainListener()):
        for unit in ("a", "b"):
            listener.end(Token(unit, Path("x.h5"), "failed", "the start is singular"))
        assert capsys.readouterr().err == (
            "noiseid: a failed: the start is singular\nnoiseid: b failed: for the same reason as a\n"
        )


def test_guarded_keeps_what_is_not_an_error():
    def command(value):
        if value == "bad":
            raise DataError("no")
        return value

    assert console.guarded(command)("good") == "good"
    import typer

    with pytest.raises(typer.Exit) as left:
        console.guarded(command)("bad")
    assert left.value.exit_code == 3


def test_numbers_that_json_lacks_become_null(capsys):
    console.answer_json({"a": [float("nan"), 1.5, (float("inf"), True)], "b": "é"})
    text = capsys.readouterr().out
    assert json.loads(text) == {"a": [None, 1.5, [None, True]], "b": "é"}
    assert "é" in text

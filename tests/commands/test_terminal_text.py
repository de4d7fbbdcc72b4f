"""Wrapped text, tables and equations, and the progress that is shown on a terminal."""

import os
import pty
import re
import subprocess
from pathlib import Path

import pytest
from small_experiment import COMMAND

from noiseid_cli.commands import console, text
from noiseid_cli.commands.progress import LiveListener, PlainListener, QuietListener, listener
from noiseid_cli.pipeline.making import Token

LONG = "a1 = b·(c + d·(e - f)) + g·(h - i)² - sin(j + k)·(l - m)"


@pytest.mark.parametrize("width", range(20, 70))
def test_an_equation_loses_nothing_and_fits_where_it_can(width):
    lines = list(text.equation(LONG, width))
    assert "".join("".join(lines).split()) == "".join(LONG.split())
    # The longest piece without an operator to break at decides what is possible.
    assert max(map(len, lines)) <= max(width, 24)
    assert all(line.lstrip().startswith(("+ ", "- ")) for line in lines[1:])


def test_an_equation_breaks_outside_brackets_first():
    assert list(text.equation(LONG, 42)) == [
        "  a1 = b·(c + d·(e - f)) + g·(h - i)²",
        "       - sin(j + k)·(l - m)",
    ]
    assert list(text.equation("x = { aaaa if b > c; dddd - e otherwise }", 30)) == [
        "  x = { aaaa if b > c;",
        "        dddd - e otherwise }",
    ]
    assert list(text.equation("x = { a if b; c otherwise }", 30)) == ["  x = { a if b; c otherwise }"]


def test_what_steers_a_terminal_is_shown_as_its_escape(capsys):
    assert text.visible("a\x1b[2J\u202eb\tÄ·²\n") == "a\\x1b[2J\\u202eb\tÄ·²\n"
    console.complain("x\u2066y\x07")
    assert capsys.readouterr().err == "noiseid: x\\u2066y\\x07\n"


def test_cells_of_a_wide_table_wrap_in_their_column():
    rows = [("m1", "kg", "mass of the first of all the arms"), ("J", "kg m^2", "short")]
    assert list(text.table(("name", "unit", "what"), rows, 36)) == [
        "  name  unit    what",
        "  m1    kg      mass of the first of",
        "                all the arms",
        "  J     kg m^2  short",
    ]
    assert (
        list(text.table(("name", "unit", "what"), rows, 80))[1] == "  m1    kg      mass of the first of all the arms"
    )


def test_sentences_hang_and_excerpts_stay_whole():
    told = "one two three four\n  five six seven eight\n    " + "x" * 30
    assert text.wrapped(told, 12).splitlines() == [
        "one two",
        "  three four",
        "  five six",
        "    seven",
        "    eight",
        "    " + "x" * 30,
    ]


def test_facts_stand_in_a_column():
    assert list(text.facts([("a", "one two three"), ("long", "four"), ("none", "")], 14, " ")) == [
        " a     one two",
        "       three",
        " long  four",
        " none",
    ]


def test_the_width_is_that_of_the_terminal_or_100(monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    with Path(os.devnull).open() as nowhere:
        assert console.width(nowhere) == 100
    monkeypatch.setenv("COLUMNS", "77")
    assert console.width() == 77


def on_a_terminal(*arguments, columns=80):
    """Run a command with a terminal as stderr and a pipe as stdout; both texts and the exit code."""
    ours, theirs = pty.openpty()
    environment = {k: v for k, v in os.environ.items() if k not in ("COLUMNS", "NO_COLOR")}
    environment["TERM"] = "xterm-256color"
    # No size was set: a pty then says 0 columns, and COLUMNS decides.
    environment["COLUMNS"] = str(columns)
    process = subprocess.Popen(
        [*COMMAND, *arguments], stdout=subprocess.PIPE, stderr=theirs, stdin=subprocess.DEVNULL, env=environment
    )
    os.close(theirs)
    seen = b""
    while True:
        try:
            part = os.read(ours, 65536)
        except OSError:  # the other side is closed
            break
        if not part:
            break
        seen += part
    os.close(ours)
    out = process.communicate()[0].decode()
    return out, seen.decode(), process.returncode


def test_a_terminal_sees_a_display_and_a_pipe_only_the_answer(small):
    # Slow to come to rest, so that there is something to be seen.
    slow = ("simulate.samples=1200", "estimate.methods.em={acceleration: none, parameter_tolerance: 1e-12}")
    out, seen, code = on_a_terminal("run", *(flag for setting in slow for flag in ("--set", setting)))
    assert code == 0
    assert "\x1b" not in out
    assert out.rstrip().endswith("report: runs/small/report/report.md")
    plain = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", seen)
    assert re.search(r"estimate ━+ +0/2 +0:00:0\d left", plain)
    assert re.search(r"  replicate-000/em/start-0  pass \d+  log-likelihood \d+\.\d\d  \d s", plain)
    assert max(len(line) for line in re.split(r"[\r\n]+", plain)) <= 80
    assert re.search(r"replicate-000/em/start-0: converged after \d+ passes", plain)
    # The cursor is hidden by the display and shown again.
    assert seen.count("\x1b[?25l") == seen.count("\x1b[?25h") > 0


def test_the_listener_fits_flags_and_terminal(monkeypatch):
    assert type(listener(quiet=True, verbose=True)) is QuietListener
    assert type(listener(quiet=False, verbose=False)) is PlainListener
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    assert type(listener(quiet=False, verbose=False)) is LiveListener
    monkeypatch.setenv("TERM", "dumb")
    assert type(listener(quiet=False, verbose=False)) is PlainListener


def test_a_live_display_forgets_what_has_ended(capsys):
    live = LiveListener()
    with live:
        live.stage("estimate", 3, 1)
        live.begin("a")
        live.compiling("a", 3, "ekf.run_filter")
        rows = live._picture().renderables[1]
        assert [list(column.cells) for column in rows.columns][1:3] == [["compiling kernel 3"], ["ekf.run_filter"]]
        live.passed("a", 2, -1.5)
        rows = live._picture().renderables[1]
        assert [list(column.cells) for column in rows.columns][:3] == [["  a"], ["pass 2"], ["log-likelihood -1.50"]]
        live.end(Token("a", Path("a.h5"), "made", "converged", "converged", 0.1))
        assert live._picture().renderables[1].row_count == 0
        assert live._bar.tasks[0].completed == 2
        live.say("once")
        live.say("once")
    assert live._bar.tasks == []
    told = capsys.readouterr().err
    assert told.splitlines()[:3] == ["estimate: 3 units, 1 there already", "  a: converged, 0.1 s", "once"]
    assert told.count("once") == 1

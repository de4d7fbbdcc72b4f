"""`make bench WRITE=1` finds the places of its tables in README.md and docs/speed.md."""

import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def bench(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return importlib.import_module("run")


def test_each_table_takes_its_own_place_and_no_other(bench):
    for name, page in bench.TABLES.items():
        text = (ROOT / page).read_text()
        written = bench.put(text, name, "\nthe machine\n\n| a table |")
        assert "the machine\n\n| a table |\n\n<!-- end of bench -->" in written
        assert bench.put(written, name, "other") == bench.put(text, name, "other")
        before, after = text.split(f"<!-- bench {name} -->")
        assert written.startswith(before)
        assert written.endswith(after.split("<!-- end of bench -->", 1)[1])


def test_a_page_without_the_place_is_refused(bench):
    for page in ("", "<!-- bench ef -->\n", "<!-- end of bench -->\n<!-- bench ef -->\n"):
        with pytest.raises(ValueError, match="no place for the table ef"):
            bench.put(page, "ef", "")


def test_every_benchmark_has_one_table(bench):
    assert sorted("".join(name for name in bench.TABLES if name != bench.ACCELERATIONS)) == list("abcdefg")
    assert [name[0] for name in bench.MODULES] == list("abcdefg")
    assert bench.table(bench.ACCELERATIONS, "abc") == ""


def test_letters_that_are_none_are_refused(bench, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["run.py", "ax"])
    with pytest.raises(SystemExit):
        bench.main()
    assert "no benchmark x; they are a to g" in capsys.readouterr().err

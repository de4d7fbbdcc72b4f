"""Logs of any make before `noiseid import` and `noiseid init`: taken, or refused in a sentence; never a traceback.

In the suite some of each, in `make fuzz` many.
"""

import json
import random

import numpy as np
import pytest
from fuzz import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.io import savemat
from typer.testing import CliRunner

from noiseid_cli.app import app

CELLS = [
    *(
        "",
        "nan",
        "NaN",
        "inf",
        "-inf",
        "1e400",
        "-1e400",
        "1e308",
        "-1e308",
        "5e-324",
        "1e-160",
        "0x10",
        "1_000",
        "1,5",
    ),
    *(
        "n/a",
        "null",
        "--",
        "'1'",
        '"1',
        '""',
        '"a;b"',
        "=1+1",
        "1e",
        ".",
        "-",
        "+",
        "é",
        "\u202e",
        "\x1b[2J",
        "١٢",
        "1 2",
    ),
    *("9" * 400, "0" * 400 + "1", "1;2", "#", "\t", "True", "2024-01-01", "12:30:00", "\x0b", "\x85", "1\x00", '"' * 3),
]
NAMES = [
    "t",
    "y",
    "u",
    "",
    "t t",
    '"t"',
    "y[m]",
    "y",
    "é",
    "1",
    "-1",
    "#y",
    "\ufeff",
    "a" * 300,
    "nan",
    "\x1b[2J",
    "日本",
]
ENDS = ["\n", "\r\n", "\r", "\n\n", "\n \n", "\x0c\n"]
CODES = ["utf-8", "utf-8-sig", "latin-1", "utf-16", "utf-16-le", "utf-32", "cp1252", "shift_jis", "utf-7"]


@st.composite
def tables(draw):
    """The bytes of a table: mostly right, with up to three odd cells or lines, in any encoding, sometimes damaged."""
    rng = random.Random(draw(st.integers(0, 2**32)))
    rows, names = rng.choice([0, 1, 2, 5, 40]), ["t", "u", "y"]
    if rng.random() < 0.3:
        names[rng.randrange(3)] = rng.choice(NAMES)
    scale = rng.choice([1.0, 1.0, 1.0, 1e150, 1e-160, 1e300, 0.0])
    step = rng.choice([0.1, 0.1, 0.1, 0.0, -0.1, 1e300, 1e-300])
    lines = [[f"{step * k:.9g}", f"{rng.gauss(0, 1):.6g}", f"{scale * rng.gauss(0, 1):.6g}"] for k in range(rows)]
    for _ in range(rng.choice([0, 1, 1, 2, 3]) if lines else 0):
        line = rng.choice(lines)
        k = rng.randrange(len(line)) if line else 0
        change = rng.randrange(6)
        if change == 0 and line:
            del line[k]
        elif change == 1:
            line.insert(k, rng.choice(CELLS))
        elif change == 2:
            lines.insert(rng.randrange(len(lines)), list(line))
        elif line:
            line[k] = rng.choice(CELLS)
    delimiter, end = rng.choice([",", ",", ";", "\t", "|", " ", "::"]), rng.choice(["\n", "\n", *ENDS])
    header = [] if rng.random() < 0.1 else [names]
    text = end.join(delimiter.join(row) for row in [*header, *lines]) + rng.choice(["", end, end * 3])
    data = text.encode(rng.choice(["utf-8", "utf-8", "utf-8", *CODES]), "replace")
    if rng.random() < 0.2 and data:
        i = rng.randrange(len(data))
        data = data[:i] + rng.choice([b"\0", b"\xff\xfe", b'"' * 200_000, rng.randbytes(8), b""]) + data[i + 5 :]
    return data


PROBLEMS = {
    "non_number": ["error", "drop", "mark_missing"],
    "repeated_stamp": ["error", "drop", "mark_missing"],
    "backward_stamp": ["error", "drop"],
    "gap": ["error", "mark_missing", "split"],
}


@st.composite
def sections(draw, file):
    """An import section for such a file."""
    section = {
        "recordings": {"a": {"file": file}},
        "time": draw(st.sampled_from([{"column": "t"}, {"column": 1}, {"interval": 0.1}])),
        "inputs": {"u1": draw(st.sampled_from(["u", 2, {"column": "u", "scale": 1e300}]))},
        "outputs": {"y1": draw(st.sampled_from(["y", "y", 3, 99, {"column": "y", "scale": -1e-300, "offset": 1e300}]))},
        "on_problem": {kind: draw(st.sampled_from(choices)) for kind, choices in PROBLEMS.items()},
    }
    if draw(st.integers(0, 3)) == 0:
        section["format"] = draw(
            st.sampled_from([{"delimiter": '"'}, {"decimal": ","}, {"header": True}, {"comment": "1"}, {"kind": "npz"}])
        )
    if draw(st.integers(0, 3)) == 0:
        section["decimate"] = 2
    if draw(st.integers(0, 3)) == 0:
        section["recordings"]["a"]["rows"] = draw(st.sampled_from([[1, 2], [2, 1000], [30, 35]]))
    return section


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path


def outcome(*words):
    """How a command ends: a usual code, a sentence where it refuses, and no log of a bug."""
    ended = CliRunner().invoke(app, words)
    assert ended.exit_code in (0, 2, 3, 4), (ended.exit_code, ended.stderr)
    assert "Traceback" not in ended.stderr
    assert "\x1b" not in ended.stderr + ended.stdout
    assert "\u202e" not in ended.stderr + ended.stdout
    assert ended.exit_code != 3 or any(line.startswith("noiseid: ") for line in ended.stderr.splitlines())
    return ended


def imported(folder, section):
    """`noiseid import` with that section."""
    linear = {"A": [[0.5]], "B": [[1]], "C": [[1]]}
    (folder / "noiseid.yaml").write_text(
        json.dumps({"experiment": "fuzz", "model": {"linear": linear}, "import": section})
    )
    return outcome("import", "-q", "--force")


@settings(max_examples=examples(60))
@given(tables(), sections("log.csv"))
def test_tables_are_imported_or_refused(folder, tried, data, section):
    tried()
    (folder / "log.csv").write_bytes(data)
    imported(folder, section)


@settings(max_examples=examples(15, 4))
@given(tables())
def test_an_experiment_is_made_of_a_table_or_refused(folder, tried, data):
    tried()
    (folder / "log.csv").write_bytes(data)
    if outcome("init", "new.yaml", "--from", "log.csv", "--force").exit_code == 0:
        outcome("check", "new.yaml")


N = 30
TIME = np.arange(N) * 0.1
COLUMNS = {
    "vector": TIME,
    "column": TIME[:, None],
    "matrix": np.ones((N, 2)),
    "cube": np.ones((2, N, 2)),
    "short": TIME[:5],
    "empty": np.empty((0, 0)),
    "one": np.array(3.0),
    "complex": TIME + 1j,
    "whole": np.arange(N, dtype=np.int64) * 2**55,
    "small": np.arange(N, dtype=np.uint8),
    "true": np.ones(N, dtype=bool),
    "huge": TIME * 1e307,
    "tiny": TIME * 1e-320,
    "not": np.where(TIME > 1, np.nan, np.inf),
    "text": "hello",
    "texts": np.array(["a", "bcd"]),
    "cells": np.array([TIME, "x", np.ones(2)], dtype=object),
    "objects": np.array([{"y": TIME}, {"y": 2}], dtype=object),
    "struct": {"y": TIME, "u": {"y": TIME}},
    "records": np.array([(1.0, 2)], dtype=[("y", "f8"), ("u", "i4")]),
    "sparse": sparse.csc_matrix(np.eye(N)[:, :1]),
}


@settings(max_examples=examples(6, 10))
@given(
    st.fixed_dictionaries({name: st.sampled_from(["vector", *COLUMNS]) for name in ("t", "u", "y")}),
    st.booleans(),
    st.integers(0, 2**32),
)
def test_mat_files_are_imported_or_refused(folder, tried, kinds, compressed, seed):
    tried()
    rng, file = random.Random(seed), folder / "log.mat"
    savemat(file, {name: COLUMNS[kind] for name, kind in kinds.items()}, do_compression=compressed)
    if rng.random() < 0.4:
        data = bytearray(file.read_bytes())
        for _ in range(rng.randint(1, 8)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        file.write_bytes(data[: rng.choice([None, None, len(data) // 2])])
    section = {"recordings": {"a": {"file": "log.mat"}}, "time": {"column": "t"}}
    imported(folder, section | {"inputs": {"u1": "u"}, "outputs": {"y1": "y"}})

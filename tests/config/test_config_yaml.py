import os
import random
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from noiseid_cli.config.load import builtin_experiment, load_experiment
from noiseid_cli.config.yaml_loader import MAX_NODES, parse_yaml, read_yaml
from noiseid_cli.errors import ConfigError, DataError

MIB = 1 << 20
CANARY = "canary_was_here"

TAGS = [
    f"!!python/object/apply:os.system ['touch {CANARY}']",
    f"!!python/object/new:os.system ['touch {CANARY}']",
    f"!!python/object/apply:subprocess.check_output [['touch', '{CANARY}']]",
    f"!!python/object/apply:builtins.eval [\"open('{CANARY}', 'w')\"]",
    f"!!python/object/new:type {{args: ['z', [], {{}}], state: '{CANARY}'}}",
    "!!python/name:os.system",
    "!!python/module:this",
    "!!python/tuple [1, 2]",
    "!!python/object:builtins.dict {}",
    "!!python/bytes 'YQ=='",
    "!!binary YQ==",
    "!!timestamp 2001-12-14",
    "!!int '3'",
    "!!float x",
    "!!set {a, b}",
    "!!omap [a: 1]",
    "!!str 5",
    "! 5",
    "!local 5",
    "!<tag:yaml.org,2002:int> 3",
    "!<tag:yaml.org,2002:python/name:os.system> ''",
]

BOMBS = {
    "aliases": "a: &a [x,x]\n" + "".join(f"{c}: &{c} [*{p},*{p}]\n" for p, c in zip("abcdefg", "bcdefgh", strict=True)),
    "merges": "a: &a {x: 1}\nb: &b {<<: [*a,*a,*a]}\nc: {<<: [*b,*b,*b]}",
    "self reference": "a: &a [*a]",
    "brackets": "[" * MIB,
    "braces": "{" * MIB,
    "named brackets": "[a," * (MIB // 3),
    "dashes": "- " * (MIB // 2),
    "question marks": "? " * (MIB // 2),
    "steps": "".join(" " * i + "a:\n" for i in range(1400)),
    "many lists": "[" + "[]," * (MIB // 3),
    "many keys": "".join(f"k{i}: 1\n" for i in range(MAX_NODES)),
    "equal keys": "a: 1\n" * 100_000,
    "anchors": "a: [" + "&a 1, " * 100_000 + "]",
    "long integers": "a: [" + ("1" * 50 + ", ") * 10_000 + "]",
    "one long integer": "a: " + "1" * (MIB - 4),
    "one long float": "a: 0." + "1" * (MIB - 8),
    "hexadecimal": "a: 0x" + "f" * (MIB - 8),
    "open bracket": "a: [" + "\n " * (MIB // 2),
    "documents": "---\n" * (MIB // 4),
    "code beyond Unicode": 'a: "\\UFFFFFFFF"',
    "version": "%YAML " + "1" * 5000 + ".1\n--- a",
    "long key": "k" * MIB + ": 1",
    "long tag": "!<" + "%20" * 300_000 + "> x",
    "long alias": "*" + "a" * MIB,
}

DOCUMENTS = {
    "duplicate key": "a: 1\nb: 2\na: 3",
    "key as list": "? [a, b]\n: 1",
    "key as alias": "? *a\n: 1",
    "empty key": ": 1",
    "merge key": "<<: {a: 1}",
    "tagged key": "!!str a: 1",
    "directive": "%YAML 1.1\n---\na: 1",
    "tag directive": "%TAG ! tag:x,2000:\n---\na: 1",
    "second document": "a: 1\n---\nb: 2",
    "tab": "a:\n\tb: 1",
    "open quote": 'a: "b',
    "open list": "a: [1, 2",
    "wrong indentation": "a:\n    b: 1\n  c: 2",
    "two colons": "a: b: c",
    "no colon": "a: 1\nb\nc: 2",
    "NUL": "a: \0",
    "escape": "a: \x1b[31m",
    "escaped escape": 'a: "\\e[31m"',
    "escaped NUL": 'a: "\\0"',
    "half a pair": 'a: "\\ud800"',
    "control in key": '"\\e": 1',
    "percent": "a: %x",
    "at": "a: @x",
}


@pytest.fixture(autouse=True)
def _in_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def refused(text):
    """Problems of a text that must be refused by the loader or by the whole way in, within a second."""
    file = "hostile.yaml"
    with open(file, "w", encoding="utf-8", errors="surrogatepass", newline="") as out:  # noqa: PTH123
        out.write(text)
    started = time.process_time()
    with pytest.raises((ConfigError, DataError)) as caught:
        load_experiment(file)
    assert time.process_time() - started < 1.0
    assert os.listdir() == [file]  # no canary  # noqa: PTH208
    assert len(str(caught.value)) < 20_000
    return caught.value


@pytest.mark.parametrize("tag", TAGS)
@pytest.mark.parametrize("place", ["{}", "experiment: {}", "a: [1, {}]"])
def test_tags_are_refused_and_nothing_runs(tag, place):
    assert "tags (" in str(refused(place.format(tag)))


@pytest.mark.parametrize("name", BOMBS)
def test_bombs_are_refused_within_a_second(name):
    refused(BOMBS[name])


@pytest.mark.parametrize("name", DOCUMENTS)
def test_hostile_documents_are_refused_by_the_loader_itself(name):
    error = refused(DOCUMENTS[name])
    assert isinstance(error, ConfigError)
    try:
        assert parse_yaml(DOCUMENTS[name], "f").problems
    except ConfigError as direct:
        assert "is not a setting" not in str(direct)  # noqa: PT017


def test_a_large_file_loads_in_a_few_seconds():
    text = "a: '" + "x" * 500_000 + "'\n" + "# comment\n" * 20_000 + "b: [" + "1.25, " * 19_000 + "]\n"
    started = time.process_time()
    data = parse_yaml(text, "f").data
    assert time.process_time() - started < 5.0
    assert len(data["b"]) == 19_000


def test_duplicate_key_names_both_lines_and_keeps_the_first():
    document = parse_yaml("a: 1\nb: {c: 2,\n    c: {d: 3}}\na: 4", "f")
    assert [(p.line, p.column, p.path) for p in document.problems] == [(3, 5, "b.c"), (4, 1, "a")]
    assert "line 2" in document.problems[0].message
    assert "line 1" in document.problems[1].message
    assert document.data == {"a": 1, "b": {"c": 2}}


def test_keys_are_the_text_that_is_written():
    assert parse_yaml("{1: a, 1.0: b, true: c, no: d}", "f").data == {
        "1": "a",
        "1.0": "b",
        "true": "c",
        "no": "d",
    }


def test_places_of_keys_and_values():
    document = parse_yaml("a:\n  - 1\n  - {b: 2,\n     c: [3,   4]}\r\nd: x\u2028# one more line\ne: y", "f")
    assert document.places[("a",)] == ((1, 1), (2, 3))
    assert document.places[("a", 1, "b")] == ((3, 6), (3, 9))
    assert document.places[("a", 1, "c", 1)] == ((4, 15), (4, 15))
    assert document.places[("e",)] == ((7, 1), (7, 4))
    problem = document.problem(("a", 1, "c", 1), "wrong")
    assert (problem.line, problem.column, problem.excerpt) == (4, 15, "     c: [3,   4]}")
    assert document.problem(("a", 1, "zz"), "missing").line == 3


def test_excerpts_are_safe_and_short():
    document = parse_yaml("a: 'x" + "y" * 300 + "'\nb: '\u202etrick'", "f")
    assert len(document.problem(("a",), "x").excerpt) < 200
    assert document.problem_at(1, 250, "x").excerpt == ""
    assert "\u202e" not in document.problem(("b",), "x").excerpt


@pytest.mark.parametrize(
    ("content", "kind", "said"),
    [
        (b"a: \xff\xfe", ConfigError, "UTF-8"),
        ("a: 1".encode("utf-16"), ConfigError, "UTF-8"),
        ("a: 1".encode("utf-32-be"), ConfigError, "control character"),
        (b"x: 1\ny: \xe9t\xe9", ConfigError, "f.yaml:2:1"),
        (b"a" * (MIB + 1), DataError, "larger than 1 MiB"),
    ],
)
def test_wrong_bytes(tmp_path, content, kind, said):
    file = tmp_path / "f.yaml"
    file.write_bytes(content)
    with pytest.raises(kind, match=said):
        read_yaml(file)


def test_byte_order_mark_is_taken(tmp_path):
    file = tmp_path / "f.yaml"
    file.write_bytes("\ufeffa: ä".encode())
    assert read_yaml(file).data == {"a": "ä"}


def test_what_is_not_a_file(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for name, said in [("none.yaml", "no such file"), (".", "a folder"), ("pipe", "not a regular file")]:
        with pytest.raises(DataError, match=said):
            read_yaml(tmp_path / name)
    for name in ["a\0b", "x" * 300]:
        with pytest.raises(DataError):
            read_yaml(tmp_path / name)


@pytest.mark.parametrize("text", ["", "# only a comment\n", "---\n", "null", "[1, 2]", "just words"])
def test_files_without_settings(tmp_path, text):
    file = tmp_path / "f.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match="it starts with `experiment: name`"):
        load_experiment(file)


STARTER = builtin_experiment().read_text()
PIECES = ["[", "]", "{", "}", ":", "- ", "\n", "\t", "&a ", "*a", "!!x ", "'", '"', "#", "|\n", "?", "1e400", ".nan",
          "010", "~", "true", "\0", "\\", "%", "<<: ", "é", "kind: ", "-1", "[[1]]", ", "]  # fmt: skip


@given(st.integers(0, 2**32), st.integers(1, 8))
@settings(max_examples=300)
def test_mutated_experiments_never_raise_anything_else(seed, count):
    rng = random.Random(seed)
    text = STARTER
    for _ in range(count):
        i, j = rng.randrange(len(text)), rng.randrange(12)
        text = (
            text[:i] + rng.choice([*PIECES, "", rng.choice(text.split() or ["x"])]) + text[i + j * rng.randrange(2) :]
        )
    with open("mutant.yaml", "w", encoding="utf-8", newline="") as file:  # noqa: PTH123
        file.write(text)
    said = None
    try:
        assert load_experiment("mutant.yaml").resolved()["experiment"]
    except ConfigError as error:
        said = str(error)
    assert said != ""
    for words in ("Input should", "pydantic", "function-", "[type=", "valid dictionary", "literal["):
        assert words not in (said or "")

"""Mutated experiments through the command line: each is taken, or refused with exit code 3 and messages; nothing else.

In the suite a few of them, in `make fuzz` many.
"""

import random
import time

import pytest
from fuzz import SEED, examples
from typer.testing import CliRunner

from noiseid_cli.app import app
from noiseid_cli.config.load import builtin_experiment

COUNT = examples(100)
SLOWEST = 10.0
PIECES = ["[", "]", "{", "}", ":", "- ", "\n", "\t", "&a ", "*a", "!!python/name:os.system ", "'", '"', "#", "|\n", "?",
          "1e400", ".nan", "010", "~", "true", "\0", "\\", "%", "<<: ", "é", "kind: ", "-1", "[[1]]", ", ", "1e9",
          "\x1b[2J", "../..", "\u202e", "0x10", "{std: [-1]}", "experiment: ../x",
          "model: {file: /etc/passwd, class: A}"]  # fmt: skip


def mutant(text: str, rng: random.Random) -> bytes:
    """The text with one to eight changes; now and then with raw bytes among them."""
    for _ in range(rng.randint(1, 8)):
        i, j = rng.randrange(len(text)), rng.randrange(12)
        new = rng.choice([*PIECES, "", rng.choice(text.split() or ["x"])])
        text = text[:i] + new + text[i + j * rng.randrange(2) :]
    data = text.encode()
    if rng.random() < 0.1:
        i = rng.randrange(len(data))
        data = data[:i] + rng.randbytes(rng.randint(1, 4)) + data[i:]
    return data


@pytest.mark.parametrize("part", range(10))
def test_mutated_experiments_are_taken_or_refused(tmp_path, monkeypatch, tried, part):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    starter, rng, refused = builtin_experiment().read_text(), random.Random(part + 1000 * SEED), 0
    for _ in range(COUNT // 10):
        tried()
        data = mutant(starter, rng)
        (tmp_path / "noiseid.yaml").write_bytes(data)
        began = time.monotonic()
        result = CliRunner().invoke(app, ["check"])
        assert time.monotonic() - began < SLOWEST, data
        assert result.exit_code in (0, 3), (result.exit_code, result.stderr, data)
        assert "Traceback" not in result.stderr
        assert "\x1b" not in result.stderr
        assert "\u202e" not in result.stderr
        if result.exit_code == 3:
            refused += 1
            assert result.stdout == ""
            assert result.stderr.splitlines()[-1].startswith("noiseid: ")
    assert refused > 0.5 * (COUNT // 10)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["noiseid.yaml"]

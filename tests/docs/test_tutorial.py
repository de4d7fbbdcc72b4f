"""The tutorial's commands run as they stand, print what it shows, and its filter repeats the report's figures."""

import re
import runpy
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from noiseid_cli.app import app

ROOT = Path(__file__).parents[2]
TUTORIAL = (ROOT / "docs" / "tutorial.md").read_text()


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", TUTORIAL, re.DOTALL)


@pytest.fixture
def followed(tmp_path, monkeypatch):
    """What each command of the tutorial prints, in a folder with the log that it asks for."""
    shutil.copy(ROOT / "data/measured/double_pendulum_excited.csv", tmp_path / "arm.csv")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")
    printed = {}
    for command in blocks("console"):
        words = command.removeprefix("$ noiseid ").split()
        result = CliRunner().invoke(app, words)
        assert result.exit_code == 0, result.output
        printed[words[0]] = result.stdout
    return printed


def test_the_tutorial_is_true(followed, capsys):
    assert list(followed) == ["init", "check", "run", "export"]
    assert followed["init"] == blocks("text")[0]
    # Other processors may differ in the last digits that are shown.
    for figure in ("58481.28", "63067.81", "0.9997", "48.21", "121.5", "1.437e-4", "2.213e-4"):
        assert figure in TUTORIAL
        assert figure[:-1] in followed["run"]
    Path("filter.py").write_text(blocks("python")[0])
    runpy.run_path("filter.py")
    loglik, nis = map(float, re.findall(r"-?\d+\.\d+", capsys.readouterr().out))
    assert loglik == pytest.approx(63067.81, abs=0.5)
    assert nis == pytest.approx(0.9997, abs=2e-4)

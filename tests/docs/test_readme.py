"""The README's examples run as they stand."""

import re
import runpy
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from noiseid_cli.app import app

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


def test_the_library_example_finds_unit_variances(tmp_path, capsys):
    script = tmp_path / "example.py"
    script.write_text(next(b for b in blocks("python") if "em.estimate" in b))
    names = runpy.run_path(str(script))
    assert capsys.readouterr().out.startswith("converged")
    final = names["result"].final
    # 500 samples of a local level with Q = R = 1: standard errors of both are about 0.15.
    assert abs(final.Q[0, 0] - 1) < 0.5
    assert abs(final.R[0, 0] - 1) < 0.5


@pytest.fixture
def log(tmp_path):
    """The README's model, experiment and a log that fits them, made with noise of known size."""
    (tmp_path / "pendulum.py").write_text(blocks("python")[0])
    (tmp_path / "noiseid.yaml").write_text(blocks("yaml")[0])
    rng = np.random.default_rng(1)
    J, mgl, dt, N = 0.05, 0.8, 0.002, 1500
    q, w, rows = 0.0, 0.0, []
    for k in range(N):
        tau = 0.3 * np.sin(2 * np.pi * 1.5 * k * dt)
        rows.append((1e3 * k * dt, tau / 0.12, (q + 1e-3 * rng.normal()) / 0.0174532925))
        total = tau + 0.2 * rng.normal()
        w += dt * (total - mgl * np.sin(q)) / J
        q += dt * w
    lines = [",".join(f"{value:.9g}" for value in row) for row in rows]
    (tmp_path / "monday.csv").write_text("\n".join(["t,current,angle_deg", *lines]) + "\n")
    return tmp_path


def test_the_pendulum_example_runs_from_log_to_report(log, monkeypatch):
    monkeypatch.chdir(log)
    result = CliRunner().invoke(app, ["run", "--json", "--quiet"])
    assert result.exit_code == 0, result.output
    assert (log / "runs/my_pendulum/report/report.html").exists()
    import json

    tables = {t["name"]: t["rows"] for t in json.loads(result.stdout)["tables"]}
    torque, angle = tables["std-process-noise"][0]["Estimate"], tables["std-measurement-noise"][0]["Estimate"]
    assert abs(torque / 0.2 - 1) < 0.3
    assert abs(angle / 1e-3 - 1) < 0.1


def test_every_command_of_the_readme_exists():
    known = {c.name or c.callback.__name__ for c in app.registered_commands} | {g.name for g in app.registered_groups}
    named = set(
        re.findall(r"noiseid (?!noiseid)([a-z]+)\b", " ".join(re.findall(r"`[^`]+`|^\$ .*$", README, re.MULTILINE)))
    )
    assert named
    assert named <= known


def test_the_linear_model_of_the_readme_runs(tmp_path):
    (tmp_path / "linear.yaml").write_text(blocks("yaml")[1])
    ran = CliRunner().invoke(app, ["run", str(tmp_path / "linear.yaml"), "--out", str(tmp_path), "--quiet"])
    assert ran.exit_code == 0, ran.output
    shown = CliRunner().invoke(app, ["models", "show", str(tmp_path / "linear.yaml")])
    assert "d w/dt = k·p + u1 + v1" in shown.output


def test_the_example_of_parameters_weighs_the_pendulum(log, monkeypatch):
    (example,) = [text for text in blocks("yaml") if "experiment: weighed" in text]
    (log / "noiseid.yaml").write_text(example)
    monkeypatch.chdir(log)
    result = CliRunner().invoke(app, ["run", "--json", "--quiet", "--set", "estimate.methods.ml.profile.points=5"])
    assert result.exit_code == 0, result.output
    import json

    tables = {t["name"]: t["rows"] for t in json.loads(result.stdout)["tables"]}
    for row in tables["parameter-estimates"]:
        assert abs(row["Estimate"] - row["Truth"]) < 5 * row["Standard error"]
    assert [row["Truth"] for row in tables["parameter-estimates"]] == [0.05, 0.8]
    assert (log / "runs/weighed/report/figures/profiles.svg").exists()

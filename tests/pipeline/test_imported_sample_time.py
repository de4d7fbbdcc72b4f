"""Recordings of a model whose sample time is one of its parameters, through the command line."""

import numpy as np
from typer.testing import CliRunner

from noiseid_cli.app import app

CONFIG = """\
experiment: slow_log
model: {name: one_link}
import:
  recordings:
    log: {file: log.csv}
  time: {column: t}
  inputs: {tau: tau}
  outputs: {q: q, ddq: ddq}
estimate:
  process_noise: {known: {diag: [1e-11, 5e-5]}}
  measurement_noise: {known: {diag: [5e-7, 5]}}
  initial_mean: {known: [0, 0]}
  initial_covariance: {known: {diag: [1e-4, 1e-4]}}
  parameters:
    mal2: {start: 0.1}
  methods:
    joint-srukf: {parameter_covariance: {mal2: 1e-6}, parameter_noise: {mal2: 1e-9}}
report: {formats: [md]}
"""


def test_the_sentence_says_what_to_set_and_then_it_runs(tmp_path):
    rows = [f"{0.001 * k:.3f},0,{1e-3 * np.sin(k):.6f},0" for k in range(40)]
    (tmp_path / "log.csv").write_text("\n".join(["t,tau,q,ddq", *rows]) + "\n")
    (tmp_path / "e.yaml").write_text(CONFIG)
    given = ["run", str(tmp_path / "e.yaml"), "--out", str(tmp_path / "out"), "--jobs", "1"]
    found = CliRunner().invoke(app, given)
    assert found.exit_code == 3  # no unit is left
    assert "set model.parameters.Ts to 0.001" in " ".join(found.output.split())
    assert CliRunner().invoke(app, [*given, "--set", "model.parameters={Ts: 0.001}"]).exit_code == 0

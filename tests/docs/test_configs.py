"""Every shipped experiment is right, and runs when cut short."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from noiseid_cli.app import app

CONFIGS = sorted((Path(__file__).parents[2] / "configs").rglob("*.yaml"))
SHORT = {
    "axelsson2011": ["--set", "simulate.samples=150", "--set", "estimate.starts.draw.count=2",
                     "--set", "simulate.held_out.tests=1", "--set", "estimate.methods.alg3-full.max_passes=3"],
    "axelsson2011_replicates": ["--set", "simulate.samples=150", "--set", "simulate.replicates=2",
                                "--set", "simulate.held_out.tests=1"],
    "coloured_noise": ["--set", "import.recordings.swing_up.rows=[1, 300]",
                       "--set", "estimate.methods.ml.max_passes=8"],
    "local_level": [],
    "ensemble_one_link": ["--set", "simulate.tests=8", "--set", "simulate.samples=60",
                          "--set", "estimate.methods.batch-ml.at_tests=[5]",
                          "--set", "estimate.methods.recursive-ml.first=5",
                          "--set", "estimate.methods.recursive-literal.first=5"],
    "porter1983_many_tests": ["--set", "simulate.replicates=1", "--set", "simulate.tests=8",
                              "--set", "simulate.samples=60", "--set", "estimate.methods.batch-ml.at_tests=[5]"],
    "porter1983_replicates": ["--set", "simulate.replicates=2", "--set", "simulate.tests=8",
                              "--set", "simulate.samples=60", "--set", "estimate.methods.batch-ml.at_tests=[5]"],
    "porter1983": ["--set", "simulate.tests=8", "--set", "simulate.samples=60",
                   "--set", "estimate.methods.batch-ml.at_tests=[5]"],
    "quickstart": ["--set", "simulate.samples=150", "--set", "estimate.methods.em-plain.max_passes=4"],
    "linear_two_state": ["--set", "simulate.samples=100", "--set", "simulate.replicates=3"],
    "flexible_robot": ["--set", "simulate.samples=150", "--set", "simulate.replicates=2"],
    "friction_left_out": ["--set", "import.recordings.excited.rows=[1, 400]"],
    "measured_holdout": ["--set", "import.recordings.excited.rows=[1, 400]",
                         "--set", "import.recordings.swing_up.rows=[1, 400]",
                         "--set", "import.recordings.rest.rows=[1, 400]", "--set", "estimate.methods.em.max_passes=20"],
    "rank_one": ["--set", "simulate.samples=100", "--set", "simulate.replicates=2"],
    "riva2017_one_link": ["--set", "simulate.samples=1500", "--set", "simulate.replicates=1",
                          "--set", "simulate.parameter_changes=[{at: 0.2, scale: {mu_v: 4}}]"],
    "riva2017_pendubot": ["--set", "simulate.samples=1500", "--set", "simulate.replicates=1"],
    "sweep_test_length": ["--set", "sweep.axes.samples.values=[60, 80]", "--set", "simulate.replicates=1",
                          "--set", "sweep.axes.encoder.values=[1e-12]", "--set", "estimate.methods.em.max_passes=4"],
    "double_pendulum_measured": ["--set", "import.recordings.excited.rows=[1, 400]",
                                 "--set", "import.recordings.swing_up.rows=[1, 400]"],
}  # fmt: skip


@pytest.mark.parametrize("path", CONFIGS, ids=lambda p: p.stem)
def test_shipped_experiment_checks_and_runs_cut_short(path, tmp_path):
    checked = CliRunner().invoke(app, ["check", str(path)])
    assert checked.exit_code == 0, checked.output
    assert path.stem in SHORT, "say how to cut this experiment short"
    ran = CliRunner().invoke(app, ["run", str(path), "--quiet", "--out", str(tmp_path), *SHORT[path.stem]])
    # 4: a cut-short method need not converge.
    assert ran.exit_code in (0, 4), ran.output
    assert list(tmp_path.glob("*/report/report.html"))
    assert list(tmp_path.glob("*/results/*.h5"))

"""`noiseid init --from LOG`: what it writes is right and runs, on measured logs and on made ones."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from small_experiment import noiseid, write_experiment, write_recordings

ROOT = Path(__file__).parents[2]
MEASURED = sorted((ROOT / "data" / "measured").glob("double_pendulum_*.csv"))
PENDULUM = f"{ROOT / 'configs' / 'double_pendulum.py'}:DoublePendulum"


@pytest.mark.parametrize("log", MEASURED, ids=lambda p: p.stem)
@pytest.mark.parametrize("model", ["", PENDULUM], ids=["starter", "double_pendulum"])
def test_what_it_writes_for_a_measured_log_checks_and_runs(empty, log, model):
    made = noiseid("init", "--from", log, *(["--model", model] if model else []))
    assert made.exit_code == 0, made.stderr
    assert noiseid("check").exit_code == 0
    short = ["--set", f"import.recordings.{log.stem}.rows=[1, 250]", "--set", "report.formats=[md]"]
    ran = noiseid("run", "--quiet", *short)
    # 4: a machine at rest drives its process noise to zero, slowly.
    assert ran.exit_code == 0 or (ran.exit_code == 4 and "rest" in log.stem), ran.stderr
    assert (empty / "my_model.py").exists() == (not model)
    written = yaml.safe_load((empty / "noiseid.yaml").read_text())
    assert written["import"]["time"] == {"column": "time"}
    outputs = list(written["import"]["outputs"].values())
    assert outputs == (["pos1", "pos2"] if "rest" in log.stem else ["pos_meas1", "pos_meas2"])
    # One encoder step is 3.8e-4 rad: the noise is of that size.
    assert all(5e-5 < std < 1e-3 for std in written["estimate"]["measurement_noise"]["start"]["std"])


def test_a_log_without_a_header_and_a_time_is_taken_by_its_interval(empty):
    nile = ROOT / "data" / "measured" / "nile.csv"
    refused = noiseid("init", "--from", nile)
    assert refused.exit_code == 3
    assert "--time COLUMN" in refused.stderr
    assert "--interval SECONDS" in refused.stderr
    made = noiseid("init", "--from", nile, "--interval", "1")
    assert made.exit_code == 0, made.stderr
    assert noiseid("check").exit_code == 0
    written = yaml.safe_load((empty / "noiseid.yaml").read_text())["import"]
    assert written["time"] == {"interval": 1}
    assert list(written["outputs"].values()) == [1]


def write_log(folder, name="log.csv", **columns):
    rows = np.column_stack(list(columns.values()))
    np.savetxt(folder / name, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")


@pytest.fixture
def arm(empty):
    """A log in ms with an input and two outputs of awkward names."""
    rng = np.random.default_rng(2)
    t = np.arange(300.0) * 5
    push = np.repeat(rng.normal(size=30), 10)
    write_log(empty, time_ms=t, torque=push, **{"angle [deg]": 40 * np.sin(t / 300), "lambda": rng.normal(size=300)})
    return empty


def test_units_and_awkward_names_are_taken_from_the_log(arm):
    made = noiseid("init", "sub/arm.yaml", "--from", "log.csv", "--output", "lambda", "--output", "angle [deg]")
    assert made.exit_code == 0, made.stderr
    written = yaml.safe_load((arm / "sub/arm.yaml").read_text())
    assert written["import"]["recordings"] == {"log": {"file": "../log.csv"}}
    assert written["import"]["time"]["scale"] == 1e-3
    assert written["import"]["outputs"] == {"column_lambda": "lambda", "angle": "angle [deg]"}
    assert 'Quantity("angle_speed", "deg/s"' in (arm / "sub/my_model.py").read_text()
    assert noiseid("check", "sub/arm.yaml").exit_code == 0


def test_columns_time_and_interval_can_be_said(arm):
    made = noiseid("init", "--from", "log.csv", "--interval", "0.02", "--input", "lambda", "--output", "angle [deg]")
    assert made.exit_code == 0, made.stderr
    written = yaml.safe_load((arm / "noiseid.yaml").read_text())
    assert written["import"]["time"] == {"interval": 0.02}
    assert list(written["import"]["inputs"].values()) == ["lambda"]
    assert noiseid("init", "--force", "--from", "log.csv", "--time", "time_ms").exit_code == 0
    assert yaml.safe_load((arm / "noiseid.yaml").read_text())["import"]["time"]["column"] == "time_ms"


def test_a_faulty_log_gets_choices_that_make_it_importable(empty):
    write_experiment(empty)
    write_recordings(empty)
    made = noiseid("init", "bad.yaml", "--from", "bad.csv", "--model", "cart.py:Cart", "--output", "x=pos")
    assert made.exit_code == 0, made.stderr
    assert "gap: split" in made.stdout
    assert noiseid("import", "bad.yaml", "--quiet").exit_code == 0


def test_nothing_is_overwritten_without_force(arm):
    (arm / "my_model.py").write_text("mine")
    refused = noiseid("init", "--from", "log.csv")
    assert refused.exit_code == 3
    assert "my_model.py is there already" in refused.stderr
    assert not (arm / "noiseid.yaml").exists()
    assert noiseid("init", "--from", "log.csv", "--force").exit_code == 0
    assert (arm / "my_model.py").read_text() != "mine"


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--time", "t"], "--time goes with --from LOG"),
        (["--from", "log.csv", "--time", "time_ms", "--interval", "1"], "either --time or --interval"),
        (["--from", "log.csv", "--interval", "-1"], "above 0"),
        (["--from", "log.csv", "--time", "tim_ms"], "Did you mean 'time_ms'"),
        (["--from", "log.csv", "--output", "a=torque"], "goes with --model"),
        (["--from", "log.csv", "--input", "lambda", "--output", "lambda"], "cannot be an input and an output"),
        (["--from", "log.csv", "--model", PENDULUM, "--output", "torque"], "write --output NAME=COLUMN"),
        (["--from", "log.csv", "--model", PENDULUM], "no column looks like the model's output q1"),
        (["--from", "log.csv", "--model", "flexible_robt"], "did you mean flexible_robot"),
        (["--from", "nothing.csv"], "cannot be found"),
    ],
)
def test_what_cannot_be_is_told_in_words(arm, arguments, told):
    refused = noiseid("init", *arguments)
    assert refused.exit_code == 3
    assert told in refused.stderr
    assert not (arm / "noiseid.yaml").exists()

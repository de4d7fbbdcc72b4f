"""Real logs through the command line: unequal intervals, several files, single missing channels, two rates."""

import numpy as np
import pytest
from small_experiment import MODEL
from typer.testing import CliRunner

from noiseid_cli.app import app
from noiseid_cli.storage.dataset_file import read_dataset
from noiseid_cli.storage.result_file import read_result

TWO = MODEL.replace(
    'outputs = (Quantity("x", "m", "position"),)',
    'outputs = (Quantity("x", "m", "position"), Quantity("w_meas", "m/s", "speed"))',
).replace("return [x.x]", "return [x.x, x.w]")

CONFIG = """\
experiment: logs
model: {file: cart.py, class: Cart}
import:
  recordings:
RECORDINGS
  time: {column: t}
  inputs: {f: force}
  outputs: {x: pos, w_meas: speed}
  on_problem: {unequal_interval: keep}
estimate:
  process_noise: {start: {std: [2]}}
  measurement_noise: {start: {std: [3e-3, 3e-2]}, structure: diagonal}
  initial_mean: {known: [0, 0]}
  initial_covariance: {known: {std: [1e-3, 1e-2]}}
report: {formats: [md]}
"""
R = np.array([1e-3, 1e-2])
Q = 1.0


def drive(seed, n=400, jitter=0.0):
    """Time, force and noisy outputs of the cart, by small steps of its own equations."""
    rng = np.random.default_rng(seed)
    dt = 0.01 * (1 + jitter * rng.uniform(-1, 1, size=n - 1))
    t, x, rows = 0.0, np.zeros(2), []
    for k in range(n):
        f = np.sin(3 * t)
        rows.append([t, f, *(x + R * rng.normal(size=2))])
        if k < n - 1:
            v = Q * rng.normal()
            for _ in range(20):
                x = x + dt[k] / 20 * np.array([x[1], (f + v - 40 * x[0] - x[1]) / 0.5])
            t += dt[k]
    return np.array(rows)


def write(folder, name, rows, columns="t,force,pos,speed"):
    lines = [",".join("" if np.isnan(v) else f"{v:.9g}" for v in row) for row in rows]
    (folder / name).write_text("\n".join([columns, *lines]) + "\n")


def run(folder, recordings):
    (folder / "cart.py").write_text(TWO)
    (folder / "noiseid.yaml").write_text(CONFIG.replace("RECORDINGS", recordings))
    done = CliRunner().invoke(app, ["run", str(folder / "noiseid.yaml"), "--out", str(folder / "runs"), "--jobs", "1"])
    assert done.exit_code == 0, done.output
    (result,), (dataset,) = ((folder / "runs/logs" / kind).glob("*.h5") for kind in ("results", "datasets"))
    return read_result(result).estimate, read_dataset(dataset), done.output


def close(estimate, samples):
    """R within four standard errors of n samples, 1 / sqrt(2 n) of a standard deviation each; Q within twice that."""
    assert np.sqrt(np.diag(estimate.final.R)) / R == pytest.approx(1.0, abs=4 / np.sqrt(2 * np.min(samples)))
    assert np.sqrt(estimate.final.Q[0, 0]) / Q == pytest.approx(1.0, abs=8 / np.sqrt(2 * np.min(samples)))


def test_unequal_intervals_and_two_recordings(tmp_path):
    write(tmp_path, "a.csv", drive(1, jitter=0.4))
    write(tmp_path, "b.csv", drive(2, n=250, jitter=0.4))
    estimate, dataset, _ = run(tmp_path, "    a: {file: a.csv}\n    b: {file: b.csv}")
    assert [r.samples for r in dataset.recordings] == [400, 250]
    assert np.ptp(dataset.recordings[0].dt) > 0.005
    close(estimate, 650)


def test_a_channel_with_empty_cells(tmp_path):
    """The speed comes every fourth row, in the same file."""
    rows = drive(3)
    rows[np.arange(400) % 4 != 0, 3] = np.nan
    write(tmp_path, "a.csv", rows)
    estimate, dataset, _ = run(tmp_path, "    a: {file: a.csv}")
    assert np.isfinite(dataset.recordings[0].y).sum(axis=0).tolist() == [400, 100]
    close(estimate, 100)


def test_a_slow_channel_in_a_file_of_its_own(tmp_path):
    """The speed comes every fifth sample, by a clock up to a millisecond off; one row is far from any sample."""
    rows = drive(4)
    write(tmp_path, "fast.csv", rows[:, :3], "t,force,pos")
    slow = rows[::5][:, [0, 3]]
    slow[:, 0] += 1e-3 * np.random.default_rng(0).uniform(-1, 1, size=len(slow))
    write(tmp_path, "slow.csv", [*slow, [9.0, 77.0]], "stamp,v")
    also = "{file: slow.csv, time: {column: stamp}, outputs: {w_meas: v}}"
    estimate, dataset, _ = run(tmp_path, f"    a: {{file: fast.csv, also: [{also}]}}")
    (recording,) = dataset.recordings
    seen = np.isfinite(recording.y)
    assert seen[:, 0].all()
    assert np.array_equal(np.flatnonzero(seen[:, 1]), np.arange(0, 400, 5))
    assert recording.y[::5, 1] == pytest.approx(slow[:, 1], rel=1e-8)
    (note,) = [n for n in dataset.notes if "slow.csv" in n]
    assert note.startswith("a: 80 rows of slow.csv (w_meas) put on the nearest sample, at most 0.000")
    assert note.endswith("s away; 1 row left out: no sample is near, or another row is nearer")
    close(estimate, 80)


def test_an_output_from_two_files_or_from_none_has_its_place(tmp_path):
    write(tmp_path, "a.csv", drive(5, n=5))
    (tmp_path / "cart.py").write_text(TWO)
    for setting, words in (
        ("{file: a.csv, outputs: {x: pos}, also: [{file: b.csv, outputs: {x: pos}}]}", "is taken from another file"),
        ("{file: a.csv, also: [{file: b.csv, outputs: {z: pos}}]}", "z is not one of the model's outputs"),
        ("{file: a.csv, also: [{file: b.csv, outputs: {x: pos}}]}", "also[0].file: "),
    ):
        (tmp_path / "noiseid.yaml").write_text(CONFIG.replace("RECORDINGS", f"    a: {setting}"))
        got = CliRunner().invoke(app, ["import", str(tmp_path / "noiseid.yaml"), "--out", str(tmp_path / "runs")])
        assert got.exit_code == 3
        assert words.replace("also[0]", "also.0") in " ".join(got.output.split()), got.output


def test_what_the_data_gives_away_is_said_at_import(tmp_path):
    rows = drive(6)
    rows[:, 2] = np.round(rows[:, 2] / 2e-3) * 2e-3
    rows[1:, 3] = np.diff(rows[:, 2]) / np.diff(rows[:, 0])
    rows[0, 3] = 0.0
    write(tmp_path, "a.csv", rows)
    _, dataset, output = run(tmp_path, "    a: {file: a.csv}")
    said = " ".join(output.split())
    for words in ("x moves in steps of 0.002 m", "w_meas is the backward difference of x"):
        assert any(words in note for note in dataset.notes)
        assert words in said

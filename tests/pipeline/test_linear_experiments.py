"""Linear models given by matrices in an experiment, from the file to the estimate."""

from pathlib import Path

import numpy as np
import pytest

from noiseid_cli.errors import ConfigError, ModelError
from noiseid_cli.filters.ekf import extended_kalman_filter
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.pipeline.context import open_experiment
from noiseid_cli.pipeline.datasets import make_dataset
from noiseid_cli.pipeline.estimation import make_estimate
from noiseid_cli.pipeline.units import dataset_units, estimate_units

CONFIGS = Path(__file__).parents[2] / "configs"


def made(file, folder, method="em"):
    context = open_experiment(file, folder / "runs")
    dataset = make_dataset(context, dataset_units(context)[0])
    return context, dataset, make_estimate(context, estimate_units(context, [method])[0])


@pytest.mark.parametrize("method", ["em", "ml"])
def test_the_nile_ends_at_the_published_maximum(method, tmp_path):
    """Durbin & Koopman print 15099, 1469.1 and a diffuse log-likelihood of -632.54; others print more digits."""
    _, dataset, result = made(CONFIGS / "local_level.yaml", tmp_path, method)
    assert [r.samples for r in dataset.recordings] == [100]
    assert result.estimate.status == "converged"
    assert result.estimate.final.R[0, 0] == pytest.approx(15098.518, abs=0.01)
    assert result.estimate.final.Q[0, 0] == pytest.approx(1469.176, abs=0.01)
    # An unknown first level of standard deviation s takes log(s sqrt(2 pi)) from the diffuse log-likelihood.
    assert result.estimate.loglik + np.log(1e7 * np.sqrt(2 * np.pi)) == pytest.approx(-632.5456, abs=5e-5)
    assert result.noise_names == (("step", "1e8 m^3", "change of the level in a year"),)


SIMULATED = """\
experiment: tracked
seed: 3
model:
  linear:
    A: a.csv
    B: [[0], [1]]
    G: [[0], [1]]
    C: [[1, 0]]
    states: [p, {name: w, unit: m/s}]
    discretisation: exact
    sample_time: 0.1
simulate:
  samples: 400
  trajectory: {kind: multisine, amplitude: [1], lowest: 0.1, highest: 2, lines: 3}
  process_noise: {std: [0.5], unit: density}
  measurement_noise: {std: [0.01]}
estimate:
  process_noise: {start: {std: [2], unit: density}}
  measurement_noise: {known: {std: [0.01]}}
  initial_mean: {known: truth}
  initial_covariance: {known: {std: [0, 0]}}
"""


def test_matrices_from_csv_discretised_exactly_in_a_simulation(tmp_path):
    (tmp_path / "a.csv").write_text("0,1\n-4,-0.4\n")
    (tmp_path / "e.yaml").write_text(SIMULATED)
    context, dataset, result = made(tmp_path / "e.yaml", tmp_path)
    assert [c[:2] for c in dataset.states] == [("p", ""), ("w", "m/s")]
    # 399 steps: the relative error of a standard deviation is at least 1 / sqrt(2 * 399) = 0.035; four times that.
    assert np.sqrt(result.estimate.final.Q[0, 0]) == pytest.approx(0.5, rel=0.14)
    before = context.model_digest
    (tmp_path / "a.csv").write_text("0,1\n-4,-0.5\n")
    assert open_experiment(tmp_path / "e.yaml", tmp_path).model_digest != before


REGRESSION = """\
experiment: regression
model:
  linear:
    A: [[1, 0], [0, 1]]
    file: matrices.npz
import:
  recordings: {series: {file: series.csv}}
  time: {interval: 1}
  outputs: {y1: y}
estimate:
  process_noise: {known: {std: [0, 0]}}
  measurement_noise: {start: {std: [1]}}
  initial_mean: {known: [0, 0]}
  initial_covariance: {known: {std: [0, 0]}}
"""


def write_regression(folder, samples=60):
    """A line through noisy points: the states are its coefficients, C holds the regressors of each sample."""
    rng = np.random.default_rng(5)
    X = np.column_stack((np.ones(60), rng.normal(size=60)))
    y = X @ [2.0, -1.0] + 0.3 * rng.normal(size=60)
    np.savez(folder / "matrices.npz", C=X[:samples, None, :])
    (folder / "series.csv").write_text("y\n" + "\n".join(map(repr, y.tolist())))
    (folder / "e.yaml").write_text(REGRESSION)
    return X, y


def test_time_varying_regression_is_least_squares(tmp_path):
    """With a constant state at the coefficients of least squares, the log-likelihood is that of least squares."""
    X, y = write_regression(tmp_path)
    context, dataset = with_data(tmp_path)
    coefficients, residual = np.linalg.lstsq(X, y, rcond=None)[:2]
    recording = dataset.recordings[0]
    np.testing.assert_array_equal(recording.u[:, 0], X[:, 1])
    assert [name for name, _, _ in dataset.inputs] == ["C_1_2"]
    R = residual / len(y)
    noise = NoiseValues(np.zeros((2, 2)), R[:, None], coefficients[None, :], np.zeros((2, 2)))
    filtered = extended_kalman_filter(context.compiled, recording, noise)
    expected = -0.5 * len(y) * (np.log(2 * np.pi * R[0]) + 1)
    assert filtered.loglik == pytest.approx(expected, rel=1e-12)
    before = context.model_digest
    np.savez(tmp_path / "matrices.npz", C=(X + np.array([0, 1]))[:, None, :])
    assert open_experiment(tmp_path / "e.yaml", tmp_path).model_digest != before


def with_data(folder):
    context = open_experiment(folder / "e.yaml", folder / "runs")
    return context, make_dataset(context, dataset_units(context)[0])


def test_matrices_for_another_number_of_samples_are_refused(tmp_path):
    write_regression(tmp_path, samples=59)
    with pytest.raises(ModelError, match="test 'series' has 60 samples, but C_1_2, which comes with the model, has 59"):
        with_data(tmp_path)


@pytest.mark.parametrize(
    ("old", "new", "path", "message"),
    [
        ("A: a.csv", "A: b.csv", "model.linear.A", "b.csv cannot be found"),
        ("A: a.csv", "A: [[1, 2], [3]]", "model.linear.A.1", "row 2 has 1 entries, but row 1 has 2"),
        ("A: a.csv", "A: [[1, true], [3, 4]]", "model.linear.A.0.1", "must be a number, or the name of a parameter"),
        ("A: a.csv", "A: 3", "model.linear.A", "must be rows of numbers"),
        ("A: a.csv", "A: [[0, 1], [k, 0]]", "model.linear", "k stands in a matrix and has no value"),
        ("A: a.csv", "A: [[1]]", "model.linear", "B is 2 x 1, expected 1 x 1"),
        ("    A: a.csv\n", "", "model.linear", "A is missing: give its rows, or a file that holds it"),
        ("C: [[1, 0]]", "file: b.npz", "model.linear.file", "b.npz cannot be found"),
        ("[p, {", "[p, {unit: m}, {", "model.linear.states.1.name", "is missing: its name"),
        (
            "amplitude: [1]",
            "amplitude: [1, 2]",
            "simulate.trajectory.amplitude",
            "2 numbers, but the model has 1 input:",
        ),
    ],
)
def test_mistakes_are_told_with_their_place(tmp_path, old, new, path, message):
    (tmp_path / "a.csv").write_text("0,1\n-4,-0.4\n")
    assert old in SIMULATED
    (tmp_path / "e.yaml").write_text(SIMULATED.replace(old, new))
    with pytest.raises(ConfigError) as caught:
        open_experiment(tmp_path / "e.yaml", tmp_path)
    found = [(p.path, p.message) for p in caught.value.problems]
    assert any(p.startswith(path) and message in text for p, text in found), found
    assert caught.value.problems[0].line > 1


@pytest.mark.parametrize(
    ("decimate", "samples", "second"),
    [("3", 20, lambda y: y[3]), ("{factor: 4, outputs: average}", 15, lambda y: y[4:8].mean())],
)
def test_decimation_is_asked_for_in_the_import(tmp_path, decimate, samples, second):
    _, y = write_regression(tmp_path)
    given = REGRESSION.replace("file: matrices.npz", "C: [[1, 0]]").replace(
        "  outputs: {y1: y}\n", f"  outputs: {{y1: y}}\n  decimate: {decimate}\n"
    )
    (tmp_path / "e.yaml").write_text(given)
    _, dataset = with_data(tmp_path)
    recording = dataset.recordings[0]
    assert recording.samples == samples
    assert recording.y[1, 0] == pytest.approx(second(y), rel=1e-12)
    assert "inputs averaged over the longer intervals" in dataset.notes[0]

"""Exports hold what the result holds, to the bit and in every format, with units and the convention in force."""

import io
import json
from dataclasses import replace

import numpy as np
import pytest
import scipy.io
import yaml

from noiseid_cli.errors import DataError
from noiseid_cli.estimators.estimate import Estimate, NoiseValues, Parameters
from noiseid_cli.outcome import UnitResult
from noiseid_cli.storage.export import exported, read_exported
from noiseid_cli.storage.export_formats import FORMATS
from noiseid_cli.storage.result_file import write_result

rng = np.random.default_rng(3)


def covariance(n):
    root = rng.normal(size=(n, n)) * 10.0 ** rng.uniform(-9, 3, n)
    return root @ root.T


FINAL = NoiseValues(covariance(2), covariance(1), rng.normal(size=(2, 3)), covariance(3))
START = NoiseValues(np.eye(2), np.eye(1), np.zeros((2, 3)), np.eye(3))
FOUND = Parameters(
    (("k", "N/m", "stiffness"), ("bias", "m", "offset")), np.ones(2), np.array([40.5, 0.1]), np.array([0.3, np.nan])
)
RESULT = UnitResult(
    unit="log/em/start-0", dataset="log", method_label="em", start_index=0, start_label="as given", replicate=0,
    estimate=Estimate("em", "converged", "it stood still", START, FINAL, 1.0, 2.5, 3, 0.1, parameters=FOUND),
    evaluations={}, noise_names=(("v1", "N m", ""), ("v2", "N m", "")), output_names=(("y", "µm", ""),),
    state_names=(("a", "m", ""), ("b", "m/s", ""), ("c", "1", "")), test_names=("monday", "tuesday"),
    Q_true=None, R_true=None, seconds=0.2, seed=4,
)  # fmt: skip
ATTRIBUTES = {
    "key": "ab" * 32,
    "model_sha256": "cd" * 32,
    "provenance": json.dumps({"noiseid": "0.1.0"}),
    "config": json.dumps(
        {
            "experiment": "arm",
            "estimate": {
                "process_noise": {"start": {}}, "measurement_noise": {"known": {}}, "initial_mean": {"known": {}},
                "initial_covariance": {"known": {}},
            },
        }
    ),
    "model": json.dumps(
        {
            "name": "arm",
            "discretisation": "rk4",
            "parameters": [
                {"name": "k", "value": 40.0, "unit": "N/m"}, {"name": "d", "value": 1e-7, "unit": "N s/m"}
            ],
        }
    ),
    "sample_time": json.dumps({"median": 0.002, "shortest": 0.001, "longest": 0.004, "unit": "s"}),
}  # fmt: skip


def nested(name, data):
    """What a reader of each format gets."""
    text = FORMATS[name](data)
    if name == "yaml":
        return yaml.safe_load(text)
    if name == "json":
        return json.loads(text)
    if name == "npz":
        return json.loads(str(np.load(io.BytesIO(text))["about"]))
    return json.loads(str(scipy.io.loadmat(io.BytesIO(text))["about"][0]))


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_the_same_back(name):
    data = exported(RESULT, ATTRIBUTES)
    assert nested(name, data) == data
    assert FORMATS[name](data) == FORMATS[name](data)


def test_numbers_are_those_of_the_result_to_the_bit():
    data = nested("yaml", exported(RESULT, ATTRIBUTES))
    for letter in ("Q", "R", "P0"):
        assert np.array(data[letter]["covariance"]).tobytes() == getattr(FINAL, letter).tobytes()
        np.testing.assert_array_equal(data[letter]["standard_deviations"], np.sqrt(getattr(FINAL, letter).diagonal()))
    assert data["m0"]["tests"]["tuesday"] == FINAL.m0[1].tolist()
    assert data["R"]["units"] == ["µm"]
    assert (data["Q"]["estimated"], data["R"]["estimated"]) == (True, False)


@pytest.mark.parametrize("name", ["mat", "npz"])
def test_arrays_stand_under_their_letters(name):
    text = io.BytesIO(FORMATS[name](exported(RESULT, ATTRIBUTES)))
    arrays = scipy.io.loadmat(text, simplify_cells=True) if name == "mat" else np.load(text)
    for letter in ("Q", "m0", "P0"):
        np.testing.assert_array_equal(arrays[letter], getattr(FINAL, letter))
    assert float(np.squeeze(arrays["R"])) == FINAL.R[0, 0]
    assert float(arrays["sample_time"]) == 0.002
    assert [str(v).strip() for v in arrays["P0_units"]] == ["m", "m/s", "1"]
    assert [str(v) for v in arrays["tests"]] == ["monday", "tuesday"]
    np.testing.assert_array_equal(arrays["parameters"], [40.5, 1e-7, 0.1])
    assert [str(v) for v in arrays["parameters_names"]] == ["k", "d", "bias"]


def test_estimated_parameters_take_the_place_of_the_models_own():
    rows = {row["name"]: row for row in exported(RESULT, ATTRIBUTES)["parameters"]}
    assert rows["k"] == {"name": "k", "value": 40.5, "unit": "N/m", "estimated": True, "standard_error": 0.3}
    assert rows["d"]["value"] == 1e-7
    assert not rows["d"]["estimated"]
    assert rows["bias"]["standard_error"] is None


def test_the_convention_is_that_of_the_result():
    discrete = ATTRIBUTES | {"model": ATTRIBUTES["model"].replace("rk4", "discrete")}
    held, step, density = (
        exported(result, attributes)["Q"]["meaning"]
        for result, attributes in (
            (RESULT, ATTRIBUTES), (RESULT, discrete), (replace(RESULT, density=True), ATTRIBUTES),
        )
    )  # fmt: skip
    assert "held over each sampling interval" in held
    assert "one step of the discrete model" in step
    assert "density" in density


def test_a_result_that_never_began_has_no_log_likelihood():
    diverged = replace(RESULT, estimate=replace(RESULT.estimate, loglik=np.nan, status="diverged", parameters=None))
    data = exported(diverged, ATTRIBUTES)
    assert data["log_likelihood"] is None
    assert nested("json", data) == data


def test_a_result_without_its_model_is_refused(tmp_path):
    path = tmp_path / "old.h5"
    write_result(path, RESULT, {name: text for name, text in ATTRIBUTES.items() if name != "model"})
    with pytest.raises(DataError, match="estimate --force"):
        read_exported(path)
    write_result(path, RESULT, ATTRIBUTES)
    assert read_exported(path) == exported(RESULT, ATTRIBUTES)

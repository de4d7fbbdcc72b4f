"""`noiseid export`: of an experiment and of a result file."""

import json

import numpy as np
import pytest
import yaml
from small_experiment import noiseid

from noiseid_cli.storage.result_file import read_result


@pytest.fixture
def ran(small):
    """A folder in which the small experiment has run: two starts of EM."""
    assert noiseid("run", "--quiet").exit_code == 0
    return small


def test_all_results_of_an_experiment_in_all_formats(ran):
    made = noiseid("export")
    assert made.exit_code == 0, made.stderr
    results = sorted((ran / "runs/small/results").glob("*.h5"))
    names = sorted(p.name for p in (ran / "runs/small/export").iterdir())
    assert names == sorted(f"{r.stem}.{ending}" for r in results for ending in ("yaml", "json", "mat", "npz"))
    final = read_result(results[0]).estimate.final
    data = yaml.safe_load((ran / f"runs/small/export/{results[0].stem}.yaml").read_text())
    np.testing.assert_array_equal(data["Q"]["covariance"], final.Q)
    assert data["Q"]["units"] == ["N"]
    assert data["sample_time"]["median"] == 0.01
    assert [row["value"] for row in data["parameters"]] == [40.0, 1.0, 0.5]
    assert data["provenance"]["result_key"].startswith(results[0].stem[-8:])


def test_a_result_file_elsewhere_in_one_format(ran):
    result = next((ran / "runs/small/results").glob("*start-1*.h5"))
    made = noiseid("export", result, "--to", "mine", "--format", "JSON, json")
    assert made.exit_code == 0, made.stderr
    assert [p.name for p in (ran / "mine").iterdir()] == [f"{result.stem}.json"]
    assert json.loads((ran / "mine" / f"{result.stem}.json").read_text())["result"] == "replicate-000/em/start-1"
    assert noiseid("export", result, "--format", "npz").stdout.strip().endswith(f"runs/small/export/{result.stem}.npz")
    refused = noiseid("export", result, "--seed", "3")
    assert refused.exit_code == 3
    assert "--seed goes with an experiment" in refused.stderr


def test_what_is_missing_or_did_not_converge_is_told(ran):
    other = ["--set", "estimate.methods.em.max_passes=1"]
    assert noiseid("run", "--quiet", *other).exit_code == 4
    unfinished = noiseid("export", *other, "--format", "yaml")
    assert unfinished.exit_code == 4
    assert "2 of 2 results did not converge" in unfinished.stderr
    next((ran / "runs/small/results").glob("*start-1*.h5")).unlink()
    for file in (ran / "runs/small/results").glob("*start-1*.h5"):
        file.unlink()
    missing = noiseid("export", "--format", "yaml")
    assert missing.exit_code == 4
    assert "1 of 2 results are not there yet" in missing.stderr


def test_nothing_to_export_and_unknown_formats_are_refused(small):
    refused = noiseid("export")
    assert refused.exit_code == 3
    assert "holds no results" in refused.stderr
    assert "did you mean yaml?" in noiseid("export", "--format", "json,yml").stderr

"""`noiseid diagnose` on an experiment and on a result file."""

import json
from pathlib import Path

from small_experiment import noiseid


def test_diagnose_says_the_same_of_the_experiment_and_of_its_result(small):
    assert noiseid("run", "-q", "--set", "estimate.starts.scale=[1]").exit_code == 0
    shown = noiseid("diagnose", "-q", "--set", "estimate.starts.scale=[1]")
    assert shown.exit_code == 0, shown.stderr
    for word in (
        "Filter and data",
        "NEES",
        "Innovations per output",
        "Where the misfit sits",
        "filter at the estimate",
    ):
        assert word in shown.stdout
    assert max(len(line) for line in shown.stdout.splitlines()) <= 100
    file = next(Path("runs").rglob("results/*.h5"))
    data = json.loads(noiseid("diagnose", str(file), "--at", "truth", "--json").stdout)
    assert data["at"] == "truth"
    assert [table["name"] for table in data["tables"]] == ["agreement", "innovations-truth", "where-truth"]
    assert data["findings"][0]["sentences"]


def test_diagnose_refuses_values_that_are_not_there(small):
    assert noiseid("run", "-q", "--set", "estimate.starts.scale=[1]").exit_code == 0
    file = next(Path("runs").rglob("results/*.h5"))
    refused = noiseid("diagnose", str(file), "--at", "tuning")
    assert refused.exit_code == 3
    assert "no filter was run at the tuning values" in refused.stderr
    assert noiseid("diagnose", str(file), "--at", "guess").exit_code == 2

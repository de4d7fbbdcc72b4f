"""`noiseid diff`: nothing where two runs agree, each variable that differs where they do not."""

import json
from pathlib import Path

from small_experiment import noiseid


def runs(*, other=()):
    noiseid("run", "-q", "-o", "a")
    noiseid("run", "-q", "-o", "b", *other)
    return [sorted(Path(folder).rglob("results/*.h5"))[0] for folder in "ab"]


def test_two_runs_of_one_experiment_are_the_same_to_the_last_bit(small):
    runs(other=["--jobs", "2"])
    same = noiseid("diff", "a", "b")
    assert same.exit_code == 0
    assert same.stdout == "3 files compared, 0 differ\n"


def test_what_differs_is_named_with_its_size(small):
    one, other = runs(other=["--set", "estimate.starts.scale=[0.2, 10]"])
    found = noiseid("diff", one, other)
    assert found.exit_code == 5
    assert "start/Q" in found.stdout
    data = json.loads(noiseid("diff", one, other, "--json").stdout)
    (start,) = (d for d in data["differences"][one.name] if d["name"] == "start/Q")
    assert abs(start["absolute"] - 0.1) < 1e-12
    assert abs(start["relative"] - 0.5) < 1e-12
    assert "seconds" not in found.stdout
    # The ends agree far better than the starts do.
    loose = json.loads(noiseid("diff", one, other, "--json", "--rtol", "0.01").stdout)
    assert "final/Q" not in [d["name"] for d in loose["differences"][one.name]]
    wide = json.loads(noiseid("diff", one, other, "--json", "--atol", "0.2").stdout)
    assert "start/Q" not in [d["name"] for d in wide.get("differences", {}).get(one.name, [])]


def test_files_that_only_one_folder_has_and_files_of_two_kinds(small):
    one, _ = runs()
    dataset = next(Path("a").rglob("datasets/*.h5"))
    assert noiseid("diff", one, dataset).exit_code == 3
    one.unlink()
    found = noiseid("diff", "a", "b")
    assert found.exit_code == 5
    assert f"only in one: b/small/results/{one.name}" in found.stdout
    assert noiseid("diff", "a", one).exit_code == 3

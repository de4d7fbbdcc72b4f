"""`noiseid status` says what is done, failed, missing, damaged or did not converge."""

import json
from pathlib import Path

from small_experiment import CONFIG, MEASURED, files_of, noiseid, write_experiment, write_recordings

from noiseid_cli.storage.failure_file import failure_path
from noiseid_cli.storage.lock import locked


def lines(*arguments):
    return noiseid("status", *arguments).stdout.splitlines()


def test_status_before_between_and_after(small):
    assert lines() == ["simulate: 1 unit: 1 missing", "estimate: 2 units: 2 missing"]
    assert not Path("runs").exists()  # it only looks
    noiseid("simulate", "-q")
    before = files_of(Path("runs"))
    assert lines() == ["simulate: 1 unit: 1 done", "estimate: 2 units: 2 missing"]
    assert files_of(Path("runs")) == before
    noiseid("run", "-q")
    found = noiseid("status")
    assert found.exit_code == 0
    assert found.stdout.splitlines() == ["simulate: 1 unit: 1 done", "estimate: 2 units: 2 done"]
    assert lines("--method", "alg3")[1] == "estimate: 2 units: 2 missing"


def test_a_failed_unit_is_told_with_its_reason_until_it_succeeds(empty):
    write_experiment(empty, MEASURED)
    write_recordings(empty)
    assert noiseid("run", "-q").exit_code == 4
    found = noiseid("status")
    assert found.exit_code == 4
    assert "import: 2 units: 1 done, 1 failed" in found.stdout
    assert "bad: failed: " in found.stdout
    assert "bad.csv" in found.stdout
    noiseid("run", "-q")
    assert "bad: failed after 2 tries: " in noiseid("status").stdout
    data = json.loads(noiseid("status", "--json").stdout)
    bad = next(unit for unit in data["units"] if unit["unit"] == "bad")
    assert (bad["condition"], bad["tries"]) == ("failed", 2)
    assert data["counts"]["import"] == {"done": 1, "failed": 1}
    assert data["at_work"] is None
    (empty / "bad.csv").write_text((empty / "good.csv").read_text())
    assert noiseid("run", "-q").exit_code == 0
    assert noiseid("status").exit_code == 0


def test_what_did_not_converge_and_what_is_damaged(empty):
    write_experiment(empty, CONFIG.replace("em: {}", "em: {max_passes: 2}"))
    noiseid("run", "-q")
    path = next(Path("runs/small/datasets").glob("*.h5"))
    path.write_bytes(path.read_bytes()[:-200])
    found = noiseid("status")
    assert found.exit_code == 4
    assert found.stdout.splitlines()[:2] == ["simulate: 1 unit: 1 damaged", "estimate: 2 units: 2 max passes"]
    assert "replicate-000/em/start-0" in found.stdout
    with locked(Path("runs/small"), print):
        assert "at work in runs/small: process " in noiseid("status").stdout


def test_a_reason_cannot_command_the_terminal(small):
    noiseid("simulate", "-q")
    path = next(Path("runs/small/datasets").glob("*.h5"))
    path.unlink()
    record = {"format": "noiseid-failure", "format_version": 1, "unit": "x", "reason": "\x1b[2J", "tries": 1, "at": ""}
    failure_path(path).write_text(json.dumps(record))
    found = noiseid("status")
    assert "\\x1b[2J" in found.stdout
    assert "\x1b" not in found.stdout

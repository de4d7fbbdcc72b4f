"""A second run in the folder of an experiment says so; those that only look, or have nothing to do, go on."""

import threading
from pathlib import Path

from small_experiment import noiseid

from noiseid_cli.storage.lock import locked

FOLDER = Path("runs/small")


def test_a_second_run_says_so_and_waits_where_it_is_asked_to(small):
    with locked(FOLDER, print):
        refused = noiseid("run")
        assert refused.exit_code == 3
        assert "runs/small is in use by process" in refused.stderr
        assert "--wait" in refused.stderr
        assert noiseid("run", "--dry-run").exit_code == 0
    assert not (FOLDER / "datasets").exists()
    held = locked(FOLDER, print)
    held.__enter__()
    threading.Timer(0.3, lambda: held.__exit__(None, None, None)).start()
    waited = noiseid("simulate", "--wait")
    assert waited.exit_code == 0
    assert "Waiting for process" in waited.stderr


def test_a_run_with_nothing_to_do_needs_no_lock(small):
    assert noiseid("run", "-q").exit_code == 0
    with locked(FOLDER, print):
        assert noiseid("run", "-q").exit_code == 0
        assert noiseid("report", "-q").exit_code == 0
        assert noiseid("simulate", "--force").exit_code == 3

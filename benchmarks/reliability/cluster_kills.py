"""Workers of a local dask cluster killed every few seconds during a sweep of 250 units.

    python benchmarks/reliability/cluster_kills.py [UNITS] [SECONDS]

One command runs the sweep on two workers, and one of them is killed every SECONDS (default 5) until it ends, at work or
while it starts; dask puts a new one in its place. SECONDS must be longer than a worker takes to start. A unit at which
three workers died is recorded as failed; the same command makes it afterwards. At the end the table must be that of
`--jobs 1` to the last bit, every file readable, and no .part left.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from sweep_of_500 import exit_code, forked, table, unreadable, warm_up, write_config

DONE = (0, 4)  # some estimates may end at max_passes


def workers_of(parent: int) -> list[int]:
    """Processes of dask's workers below a process: the children of its children that dask's nannies watch."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has just ended
            above = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            if above == parent and b"spawn_main" in (folder / "cmdline").read_bytes():
                found.append(int(folder.name))
    return found


def main(units: int, every: float, folder: Path) -> None:
    """Run the experiment and print what came of it."""
    warm_up()
    config, log = write_config(folder), folder / "log.txt"
    smaller = ["--set", f"simulate.replicates={units // 10}", "--set", "simulate.samples=2000"]
    whole, chaos = folder / "whole", folder / "chaos"
    began = time.monotonic()
    code = exit_code(forked(["run", str(config), *smaller, "-q", "-o", str(whole)], log))
    assert code in DONE, f"the undisturbed run ended with {code}: see {log}"
    names = {path.name for path in whole.rglob("*.h5")}
    print(f"undisturbed, --jobs 1: {len(names)} units in {time.monotonic() - began:.0f} s", flush=True)

    command = ["run", str(config), *smaller, "-o", str(chaos), "--dask", "local", "--jobs", "2"]
    rng, kills, began = random.Random(1), 0, time.monotonic()
    child, due = forked(command, folder / "chaos.txt"), 0.0
    while os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
        time.sleep(0.02)
        victims = workers_of(child)
        if len(victims) < 2:  # between the stages, and while dask puts a new one in the place of a dead one
            due = max(due, time.monotonic() + 0.5 * every)
        elif time.monotonic() >= due:
            os.kill(rng.choice(victims), signal.SIGKILL)
            kills, due = kills + 1, time.monotonic() + every
    code = exit_code(child)
    told = (folder / "chaos.txt").read_text()
    made = [path.name for path in chaos.rglob("*.h5")]
    failed = len(list(chaos.rglob("*.failed.json")))
    print(f"{kills} kills in {time.monotonic() - began:.0f} s: exit code {code}, {len(made)} units, {failed} given up")
    assert code in DONE, told[-2000:]
    assert "Traceback" not in told, told[-2000:]
    assert len(made) + failed == len(names)
    if failed:
        assert exit_code(forked(["run", str(config), *smaller, "-q", "-o", str(chaos)], log)) in DONE
    same, left = table(whole) == table(chaos), len(list(chaos.rglob("*.part")))
    bad = len(list(unreadable(chaos)))
    print(f"table of {len(table(chaos))} rows equal to the last bit: {same}; unreadable: {bad}; .part left: {left}")
    assert same
    assert {path.name for path in chaos.rglob("*.h5")} == names
    assert bad == left == 0


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 250
    pause = float(sys.argv[2]) if len(sys.argv) > 2 else 5.0
    with tempfile.TemporaryDirectory(prefix="cluster-kills-") as place:
        main(count, pause, Path(place))

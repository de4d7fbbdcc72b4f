"""200 times kill -9 at random during a sweep of 500 units, gone on with by the same command each time.

    python benchmarks/reliability/kills.py [KILLS] [FOLDER]

Every kill hits a run that is at work: after a random number of new files, such that the units last for all kills. At
the end the table must be that of an undisturbed run to the last bit, every file readable, and no .part left.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from sweep_of_500 import UNITS, exit_code, forked, table, unreadable, warm_up, write_config

DONE = (0, 4)  # some estimates may end at max_passes


def files(folder: Path) -> int:
    """Number of units that are there."""
    return sum(1 for _ in folder.rglob("*.h5"))


def main(kills: int, folder: Path) -> None:
    """Run the experiment and print what came of it."""
    warm_up()
    config, log = write_config(folder), folder / "log.txt"
    whole, chaos = folder / "whole", folder / "chaos"
    began = time.monotonic()
    if files(whole) < UNITS or not list(whole.rglob("results.csv")):  # a folder that was used before has it
        code = exit_code(forked(["run", str(config), "-o", str(whole), "-q"], log))
        assert code in DONE, f"the undisturbed run ended with {code}: see {log}"
        print(f"undisturbed: {files(whole)} units in {time.monotonic() - began:.1f} s", flush=True)

    rng, hit, parts, bad, empty_handed = random.Random(1), 0, 0, 0, 0
    while hit < kills:
        before = files(chaos) if chaos.exists() else 0
        left = UNITS - before
        # So many new files that the units last for all kills.
        wanted = min(rng.randint(0, max(1, round(2 * left / (kills - hit)) - 1)), left - 1)
        jobs = "2" if hit % 20 == 19 else "1"
        child = forked(["run", str(config), "-o", str(chaos), "-q", "--jobs", jobs], log)
        while not (chaos.exists() and files(chaos) >= before + wanted):
            assert os.waitpid(child, os.WNOHANG)[0] == 0, f"a run ended by itself: see {log}"
            time.sleep(0.001)
        time.sleep(rng.uniform(0.0, 0.06))
        os.killpg(child, signal.SIGKILL) if rng.random() < 0.5 else os.kill(child, signal.SIGKILL)
        assert exit_code(child) == -signal.SIGKILL, f"a run ended before it could be killed: see {log}"
        hit += 1
        empty_handed += files(chaos) == before
        parts += len(list(chaos.rglob("*.part")))
        bad += len(list(unreadable(chaos))) if hit % 10 == 0 else 0
        if hit % 20 == 0:
            print(f"{hit} kills, {files(chaos)} units, {parts} .part files met, {bad} unreadable", flush=True)
    code = exit_code(forked(["run", str(config), "-o", str(chaos), "-q"], log))
    assert code in DONE, f"the last run ended with {code}: see {log}"
    bad += len(list(unreadable(chaos)))
    same = table(whole) == table(chaos)
    left_over = len(list(chaos.rglob("*.part")))
    names = {p.name for p in whole.rglob("*.h5")} == {p.name for p in chaos.rglob("*.h5")}
    seconds = time.monotonic() - began
    print(f"{hit} kills ({empty_handed} before a first new file), {files(chaos)} units, {seconds:.0f} s")
    print(f"table of {len(table(chaos))} rows equal to the last bit: {same}; same files: {names}")
    print(f"unreadable files: {bad}; .part files met after a kill: {parts}, left at the end: {left_over}")
    assert same
    assert names
    assert bad == left_over == 0


if __name__ == "__main__":
    kills = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    if len(sys.argv) > 2:
        main(kills, Path(sys.argv[2]))
    else:
        place = Path(tempfile.mkdtemp(prefix="kills-"))
        try:
            main(kills, place)
        finally:
            shutil.rmtree(place)

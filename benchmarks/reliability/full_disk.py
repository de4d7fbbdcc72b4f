"""A file system that fills to the brim in mid-run: clear messages, nothing lost, and on it goes when there is space.

    sudo python benchmarks/reliability/full_disk.py

Mounts a tmpfs of its own, which takes the rights of root, and takes it away at the end.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from sweep_of_500 import exit_code, forked, table, unreadable, warm_up, write_config

SMALLER = ["--set", "simulate.replicates=10"]  # 100 units


def files(folder: Path) -> dict[Path, bytes]:
    """Every unit's file with its content."""
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*.h5")}


def main(folder: Path) -> None:
    """Run the experiment and print what came of it."""
    warm_up()
    config, disk, logs = write_config(folder), folder / "disk", folder / "logs"
    disk.mkdir()
    logs.mkdir()
    command = ["run", str(config), *SMALLER, "-q", "-o"]
    whole = exit_code(forked([*command, str(folder / "whole")], logs / "whole"))
    size = sum(len(data) for data in files(folder / "whole").values())
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size // 2}", "tmpfs", str(disk)], check=True)
    try:
        began = time.monotonic()
        full = exit_code(forked([*command, str(disk)], logs / "full"))
        before, said = files(disk), (logs / "full").read_text()
        bad, parts = list(unreadable(disk)), list(disk.rglob("*.part"))
        print(f"full after {len(before)} units: exit code {full} in {time.monotonic() - began:.0f} s; all it says:")
        print(said.strip())
        print(f"unreadable files: {len(bad)}; .part files: {len(parts)}; 'Traceback' in the log: {'Traceback' in said}")
        subprocess.run(["mount", "-o", f"remount,size={8 * size}", str(disk)], check=True)
        code = exit_code(forked([*command, str(disk)], logs / "again"))
        after = files(disk)
        kept = all(after[name] == data for name, data in before.items())
        same = table(folder / "whole") == table(disk)
        print(f"with space again: exit code {code}, {len(after)} units, earlier files untouched: {kept}")
        print(f"table of {len(table(disk))} rows equal to the last bit: {same}")
        assert full == 1
        assert code == whole
        assert said.endswith("the disk is full; free some space and run the same command again.\n")
        assert said.count("\n") == 1
        assert kept
        assert same
        assert not bad
        assert not parts
        assert "Traceback" not in said
    finally:
        subprocess.run(["umount", str(disk)], check=True)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory(prefix="full-disk-") as place:
        main(Path(place))

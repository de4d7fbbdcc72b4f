"""Run the benchmarks, all or those named by their letters, and print the tables of README.md and docs/speed.md.

    python benchmarks/run.py [LETTERS] [--write]

With ``--write`` each table whose letters were all run takes its place in its file, between two markers.
"""

from __future__ import annotations

import argparse
import os
import platform
import re
import sys
import time
from importlib import import_module, metadata
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests" / "oracles"))

from timing import markdown  # noqa: E402

MODULES = ("a_robot_pass", "b_linear_em", "c_steps", "d_ensembles", "e_to_answer", "f_growth", "g_limit")
ACCELERATIONS = "accelerations"
TABLES = {"abcdg": "README.md", "ef": "docs/speed.md", ACCELERATIONS: "docs/speed.md"}


def machine() -> str:
    """What the figures were measured on."""
    cpu = platform.processor() or platform.machine()
    if (info := Path("/proc/cpuinfo")).exists() and (found := re.search(r"model name\s*: (.*)", info.read_text())):
        cpu = found[1]
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in ("numpy", "numba"))
    date, python = time.strftime("%Y-%m-%d"), platform.python_version()
    return f"{cpu}, {os.cpu_count()} cores, {platform.system()}; Python {python}, {versions}; {date}."


def table(letters: str, wanted: str) -> str:
    """The table of those of its letters that are wanted; empty where there is none."""
    rows = []
    if letters == ACCELERATIONS:
        if "e" not in wanted:
            return ""
        print("e_accelerations ...", file=sys.stderr, flush=True)
        accelerations = import_module("e_accelerations")
        return markdown(accelerations.HEAD, accelerations.rows(), 1)
    for name in MODULES:
        if name[0] in letters and name[0] in wanted:
            print(f"{name} ...", file=sys.stderr, flush=True)
            rows += import_module(name).rows()
    return markdown(("task", "program", "time", "times noiseid"), rows, 2) if rows else ""


def put(text: str, name: str, body: str) -> str:
    """The text of a page with ``body`` between the markers of a table.

    Raises:
        ValueError: the page does not have them once.
    """
    begin, end = f"<!-- bench {name} -->\n", "<!-- end of bench -->"
    if text.count(begin) != 1 or end not in text.split(begin)[1]:
        raise ValueError(f"the page has no place for the table {name}: {begin.strip()} ... {end}")
    before, rest = text.split(begin)
    return f"{before}{begin}{body}\n\n{end}{rest.split(end, 1)[1]}"


def main() -> None:
    """Print what the benchmarks give whose letters are given."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("letters", nargs="?", default="abcdefg", metavar="LETTERS", help="of the benchmarks, a to g")
    parser.add_argument("--write", action="store_true", help="put the tables into README.md and docs/speed.md")
    asked = parser.parse_args()
    if strange := set(asked.letters) - set("abcdefg"):
        parser.error(f"there is no benchmark {', '.join(sorted(strange))}; they are a to g")
    for name, page in TABLES.items():
        if not (found := table(name, asked.letters)):
            continue
        body = f"\n{machine()}\n\n{found}"
        print(body)
        if asked.write and (name == ACCELERATIONS or set(name) <= set(asked.letters)):
            path = ROOT / page
            path.write_text(put(path.read_text(), name, body))
            print(f"written to {page}", file=sys.stderr)


if __name__ == "__main__":
    main()

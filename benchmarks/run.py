"""Run the benchmarks, all or those named by their letters, and print the Markdown tables of docs/speed.md."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

from timing import markdown

MODULES = ("a_robot_pass", "b_linear_em", "c_steps", "d_ensembles", "e_to_answer", "f_growth", "g_limit")


def main(letters: str) -> None:
    """Print what the benchmarks give whose letters are given."""
    table = []
    for name in MODULES:
        if name[0] in letters:
            print(f"{name} ...", file=sys.stderr, flush=True)
            table += import_module(name).rows()
    print(markdown(("task", "program", "time", "times noiseid"), table, 2))
    if "e" in letters:
        from e_accelerations import HEAD, rows

        print(markdown(HEAD, rows(), 1))


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "oracles"))
    main(sys.argv[1] if len(sys.argv) > 1 else "abcdefg")

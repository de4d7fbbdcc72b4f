"""A sweep of 500 small units, a warmed-up process that forks commands on it, and what of its results counts."""

from __future__ import annotations

import csv
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

CONFIG = """\
experiment: many
seed: 5
model:
  linear:
    A: [[0.9]]
    C: [[1]]
    discretisation: discrete
    sample_time: 1
simulate:
  samples: 60
  replicates: 50
  trajectory: {kind: zero}
  process_noise: {std: [1]}
  measurement_noise: {std: [1]}
estimate:
  process_noise: {start: {std: [1]}}
  measurement_noise: {known: {std: [1]}}
  initial_mean: {known: [0]}
  initial_covariance: {known: {std: [1]}}
  starts: {scale: [0.1, 1, 10, 100]}
  methods: {em: {max_passes: 20}}
sweep:
  axes:
    gain: {vary: model.linear.A.0.0, values: [0.9, 0.5]}
report: {formats: [csv]}
"""
UNITS = 500


def write_config(folder: Path) -> Path:
    """Put the experiment into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "many.yaml"
    file.write_text(CONFIG)
    return file


def warm_up() -> None:
    """Import what a command needs, so that a fork of this process is at work at once."""
    import h5py
    import scipy.linalg

    assert h5py
    assert scipy.linalg


def forked(arguments: list[str], log: Path) -> int:
    """Run a command in a fork of this process, in a group of its own; give its number."""
    child = os.fork()
    if child:
        return child
    os.setpgid(0, 0)
    handle = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(handle, 1)
    os.dup2(handle, 2)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.argv = ["noiseid", *arguments]
    from noiseid_cli.app import main

    code = 1
    try:
        main()
        code = 0
    except SystemExit as end:
        code = int(end.code or 0)
    finally:
        os._exit(code)


def exit_code(child: int) -> int:
    """Wait for a fork; its exit code, or minus the signal that ended it."""
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def table(folder: Path) -> list[dict[str, str]]:
    """The final table in full precision, without the wall-clock times."""
    (file,) = folder.rglob("results.csv")
    with file.open(newline="") as stream:
        return [row for row in csv.DictReader(stream) if not row["metric"].endswith("seconds")]


def unreadable(folder: Path) -> Iterator[str]:
    """Files of units under their final names that are not whole."""
    from noiseid_cli.errors import NoiseidError
    from noiseid_cli.storage.dataset_file import read_dataset
    from noiseid_cli.storage.result_file import read_result

    for path in folder.rglob("*.h5"):
        try:
            (read_dataset if path.parent.name == "datasets" else read_result)(path)
        except NoiseidError as error:
            yield str(error)

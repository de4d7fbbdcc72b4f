"""A small model and experiment, quick to run, and ways to run commands on them."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
from typer.testing import CliRunner

from noiseid_cli.app import app

MODEL = '''
from noiseid_cli.models import Model, Parameter, Quantity


class Cart(Model):
    """Cart on a spring; its position is measured."""

    name = "cart"
    citation = "A cart of our own."
    states = (Quantity("x", "m", "position"), Quantity("w", "m/s", "speed"))
    inputs = (Quantity("f", "N", "force"),)
    noises = (Quantity("v", "N", "force noise"),)
    outputs = (Quantity("x", "m", "position"),)
    parameters = (Parameter("k", 40.0, "N/m"), Parameter("d", 1.0, "N s/m"), Parameter("m", 0.5, "kg"))
    sample_time = 0.01
    discretisation = "rk4"

    def dynamics(self, x, u, v, p):
        return [x.w, (u.f + v.v - p.k * x.x - p.d * x.w) / p.m]

    def output(self, x, u, p):
        return [x.x]
'''

CONFIG = """\
experiment: small
seed: 7
model: {file: cart.py, class: Cart}
simulate:
  samples: 80
  trajectory: {kind: multisine, amplitude: [1], lowest: 1, highest: 5, lines: 3}
  process_noise: {std: [0.5]}
  measurement_noise: {std: [1e-3]}
estimate:
  process_noise: {start: {std: [1]}}
  measurement_noise: {known: {std: [1e-3]}}
  initial_mean: {known: truth}
  initial_covariance: {known: {std: [1e-3, 1e-2]}}
  starts: {scale: [0.1, 10]}
  methods:
    em: {}
report: {formats: [csv, md]}
"""

MEASURED = CONFIG.replace(
    CONFIG[CONFIG.index("simulate:") : CONFIG.index("estimate:")],
    """\
import:
  recordings:
    good: {file: good.csv}
    bad: {file: bad.csv}
  group: separate
  time: {column: t}
  inputs: {f: force}
  outputs: {x: pos}
""",
).replace("{known: truth}", "{known: [0, 0]}")


def write_experiment(folder: Path, config: str = CONFIG) -> Path:
    """Put the experiment and its model in a folder."""
    (folder / "cart.py").write_text(MODEL)
    file = folder / "noiseid.yaml"
    file.write_text(config)
    return file


def write_recordings(folder: Path) -> None:
    """A whole log, and one with a text cell in line 5, a repeated stamp in line 9 and a gap before line 13."""
    rng = np.random.default_rng(3)
    rows = [[f"{0.01 * k:.2f}", "0", f"{1e-3 * rng.normal():.7f}"] for k in range(80)]
    (folder / "good.csv").write_text("t,force,pos\n" + "".join(",".join(row) + "\n" for row in rows))
    rows[3][2] = "n/a?"
    rows[7][0] = rows[6][0]
    del rows[11:60]
    (folder / "bad.csv").write_text("t,force,pos\n" + "".join(",".join(row) + "\n" for row in rows))


def noiseid(*arguments: str):
    """Run a command in this process; the result has exit_code, stdout and stderr."""
    return CliRunner().invoke(app, [str(a) for a in arguments])


COMMAND = [sys.executable, "-c", "from noiseid_cli.app import main; main()"]


def spawn(*arguments: str, **options) -> subprocess.Popen:
    """Start a command as a process of its own, which heeds Ctrl-C even if these tests run in the background."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | options
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        return subprocess.Popen([*COMMAND, *arguments], text=True, **pipes)
    finally:
        signal.signal(signal.SIGINT, before)


def files_of(folder: Path) -> dict[str, int]:
    """Every file below a folder, with the time of its last change."""
    return {str(p.relative_to(folder)): p.stat().st_mtime_ns for p in sorted(folder.rglob("*")) if p.is_file()}


def arrays_of(path: Path) -> dict[str, bytes]:
    """The bytes of every array of a result or dataset file, but for the wall-clock times."""
    out = {}

    def keep(name, item):
        if isinstance(item, h5py.Dataset) and not name.endswith("seconds"):
            values = item[()]
            out[name] = values.tobytes() if values.dtype != object else repr(values.tolist()).encode()

    with h5py.File(path) as file:
        file.visititems(keep)
        out["config"] = json.dumps(json.loads(file.attrs["config"])).encode()
    return out

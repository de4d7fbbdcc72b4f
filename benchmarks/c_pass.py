"""The pass in C, compiled for this processor and called through ctypes."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from robot import robot_data
from to_c import functions

from noiseid_cli.filters.linalg import upper_factor
from noiseid_cli.models.registry import load_model

Pass = Callable[[], tuple[float, np.ndarray]]


def c_pass(samples: int) -> Pass | str:
    """Log-likelihood and sum of E[v v' | y] of one pass in C, or why there is none."""
    if shutil.which("gcc") is None:
        return "no gcc here"
    model, recording, noise = robot_data(samples)
    n, nv, ny, N = model.nx, model.nv, model.ny, samples
    library, wide = _library(n, nv, ny), (n + nv + 7) // 8 * 8
    given = [
        model.parameters, recording.dt, recording.u, recording.y, noise.m0[0], upper_factor(noise.P0, "P0"),
        upper_factor(noise.Q, "Q"), upper_factor(noise.R, "R"),
        *(np.zeros(shape) for shape in ((N, n), (N, n), (N - 1, n, wide), (N - 1, nv, wide), (nv, nv))),
    ]  # fmt: skip
    arrays = [np.ascontiguousarray(a) for a in given]
    p, dt, u, y, *rest = [a.ctypes.data_as(ctypes.c_void_p) for a in arrays]
    nu = ctypes.c_long(model.nu)
    return lambda: (library.em_pass(ctypes.c_long(N), p, dt, u, nu, y, *rest), arrays[-1])


def _library(n: int, nv: int, ny: int) -> ctypes.CDLL:
    head = f"#include <math.h>\n#include <string.h>\n#define NX {n}\n#define NV {nv}\n#define NY {ny}\n"
    equations = functions(load_model("flexible_robot"), ("drift_jacobian", "output_jacobian"))
    body = (Path(__file__).parent / "em_pass.c").read_text()
    folder = Path(tempfile.mkdtemp())
    (folder / "pass.c").write_text(head + equations + body)
    command = ["gcc", "-O3", "-march=native", "-shared", "-fPIC", "pass.c", "-o", "pass.so", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    library = ctypes.CDLL(str(folder / "pass.so"))
    library.em_pass.restype = ctypes.c_double
    return library

"""(g) How near the limit: the same pass in C, and floating-point operations against the core's measured peak.

The operations are those of the algorithm, from its loop bounds (a reflection of r rows and c columns takes 4 r c; the
model's equations are left out). The peak is that of NumPy's matrix product of 512 by 512 on one thread.
"""

from __future__ import annotations

import time

import numpy as np
from c_pass import c_pass
from robot import robot_data
from timing import compared, side_by_side

from noiseid_cli.estimators.em_statistics import e_step

SAMPLES = 2000


def operations(n: int, nv: int, ny: int) -> float:
    """Floating-point operations of a pass at one sample."""

    def reflections(rows: int, columns: int, pivots: int) -> float:
        return sum(4.0 * (rows - j) * (columns - j) for j in range(min(rows, pivots)))

    def upper(rows: int, others: int) -> float:
        return rows * (rows + 1.0) * others

    # A rotation takes 6 for each column that it touches.
    update = upper(n, ny) + 6.0 * (ny * n * (n + 1) / 2 + n * ny * (ny - 1) / 2) + 2.0 * n * ny
    predict = upper(n, n) + upper(nv, n) + reflections(n + nv, 2 * n + nv, n) + n * n * (n + nv)
    back = 2.0 * n * n + upper(n, n) + reflections(nv + n, n, n)
    left = reflections(n, nv + n, nv) + nv * nv * n
    moment = left + 4.0 * nv * n * n + 2.0 * nv * nv * n + upper(n, nv) + 2.0 * nv * nv * (nv + n + 1.0)
    return update + predict + back + moment


def peak() -> float:
    """Floating-point operations a second on one core."""
    a = np.random.default_rng(0).normal(size=(512, 512))
    best = np.inf
    for _ in range(20):
        wall, began = time.perf_counter(), time.thread_time()
        a @ a
        best = min(best, max(time.perf_counter() - wall, time.thread_time() - began))
    return 2.0 * 512**3 / best


def rows() -> list[list[str]]:
    """Ours against C, and the rate."""
    model, recording, noise = robot_data(SAMPLES)
    times = side_by_side(
        {"noiseid": lambda: e_step(model, [recording], noise), "C, gcc -O3 -march=native": c_pass(SAMPLES)}, runs=41
    )
    ours = times["noiseid"]
    assert isinstance(ours, float)
    table = compared(f"g. EM pass, flexible robot, N = {SAMPLES}", times)
    if isinstance(times["C, gcc -O3 -march=native"], float):
        table[1][3] = f"{times['C, gcc -O3 -march=native'] / ours:.2f}"
    count = operations(model.nx, model.nv, model.ny)
    rate, top = count * SAMPLES / ours, peak()
    table.append(["", f"{count:.0f} operations a sample: {rate / 1e9:.1f} of {top / 1e9:.0f} Gflop/s", "", ""])
    return table

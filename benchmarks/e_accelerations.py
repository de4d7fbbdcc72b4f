"""(e) Accelerations of EM: passes until the log-likelihood is within 0.01 of the best end, and until they stop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from em_accelerations import Anderson, Broyden, Secants, Squarem
from em_problems import PROBLEMS, Problem

from noiseid_cli.estimators import em

NEAR = 0.01
# Passes after which a run is given up; it counts with this many.
MOST = 300
SCHEMES = {
    "none": "plain",
    "squarem": "SQUAREM",
    "anderson": "Anderson",
    "secants": "secants",
    "broyden": "Broyden",
    "quasi_newton": "quasi-Newton",
}
HEAD = ("problem", "unknowns", *SCHEMES.values())


@dataclass(frozen=True)
class Found:
    """One run: passes until near the best end (None: never) and in all, whether it stopped by itself, seconds."""

    near: int | None
    passes: int
    stopped: bool
    short: float
    seconds: float

    def __str__(self) -> str:
        """Such as ``12 / 17``; where the best end was missed, by how much."""
        near = f"{self.short:.2g} short" if self.near is None else str(self.near)
        return f"{near} / {self.passes if self.stopped else '-'}"


def measured(problem: Problem) -> tuple[int, dict[str, Found]]:
    """Number of unknowns, and what each scheme needs."""
    model, recordings, start, unknowns = problem.pose()
    ends = {}
    for scheme in SCHEMES:
        options = em.EmOptions(acceleration=scheme, max_passes=MOST, **problem.options)  # type: ignore[arg-type]
        ends[scheme] = em.estimate(model, recordings, start, unknowns, options)
    best = max(end.loglik for end in ends.values())
    out = {}
    for scheme, end in ends.items():
        reached = np.flatnonzero(end.trace["loglik"] >= best - NEAR)
        near = int(reached[0]) + 1 if reached.size else None
        out[scheme] = Found(near, end.passes, end.status != "max_passes", best - end.loglik, end.seconds)
    return unknowns.pack(start).size, out


def rows() -> list[list[str]]:
    """Every problem, then the sums over them."""
    for name, scheme in (("squarem", Squarem), ("anderson", Anderson), ("secants", Secants), ("broyden", Broyden)):
        em.ACCELERATIONS[name] = scheme
    table, all_found = [], []
    for problem in PROBLEMS:
        size, found = measured(problem)
        table.append([problem.name, str(size), *map(str, found.values())])
        all_found.append(found)
    by_scheme = [[found[scheme] for found in all_found] for scheme in SCHEMES]
    counts = [[(f.near or MOST, f.passes) for f in column] for column in by_scheme]
    times = np.exp(np.mean(np.log(np.array(counts[0]) / np.array(counts)), axis=1))
    table.append(["times fewer passes than plain", "", *(f"{near:.1f} / {all_:.1f}" for near, all_ in times)])
    table.append(["best end missed", "", *(str(sum(f.near is None for f in column)) for column in by_scheme)])
    table.append(["did not stop", "", *(str(sum(not f.stopped for f in column)) for column in by_scheme)])
    table.append(["seconds in all", "", *(f"{sum(f.seconds for f in column):.0f}" for column in by_scheme)])
    return table

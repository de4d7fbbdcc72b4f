"""Estimated standard deviations over replicates: bias, spread, and how near the spread comes to the best possible."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from noiseid_cli.outcome import UnitResult
from noiseid_cli.report.reading import converged, covariances, group, remark, std
from noiseid_cli.report.study import Study
from noiseid_cli.report.tables import Cell, Column, Table, number

Which = Literal["Q", "R"]
_METRIC = {"Q": "process_noise_std", "R": "measurement_noise_std"}


def recovery_table(study: Study) -> Table | None:
    """Bias and spread of each standard deviation over replicates, with the Monte Carlo error of the bias.

    Where the Cramer-Rao bound is exact, the spread stands beside it. None without replicates or truth, and for a
    sweep, whose points may have truths of their own.
    """
    if study.sweep or len({r.replicate for r in study.results}) < 2 or all(r.Q_true is None for r in study.results):
        return None
    columns = [
        Column("Method"),
        Column("Noise"),
        Column("Truth"),
        Column("In"),
        Column("Replicates"),
        Column("Bias", "%", decimals=2),
        Column("± Monte Carlo", "%", decimals=2),
        Column("Spread", "%", decimals=2),
    ]
    caption = (
        "Relative to the truth, over independent noise realisations. Spread: standard deviation of one estimate. "
        "A bias beyond two or three times its Monte Carlo error is one."
    )
    if study.bounds:
        columns += [Column("Bound", "%", decimals=2), Column("Spread / bound", decimals=3)]
    rows: list[tuple[Cell, ...]] = []
    for method, units in group([r for r in study.results if converged(r)], lambda r: r.method_label).items():
        for which, i in _estimated(units):
            rows.append((method, *_row(study, units, which, i)))
    if study.bounds and rows:
        n = max(int(str(row[4])) for row in rows)
        caption += (
            " Bound: the least spread of an unbiased estimate (Cramér-Rao), exact for this linear model; of "
            f"{n} replicates the ratio has a Monte Carlo error of {100 / math.sqrt(2 * max(n - 1, 1)):.2g} %."
        )
    title = f"Bias and spread of the standard deviations{_of_what(rows, study)}"
    return Table("recovery", title, caption, tuple(columns), tuple(rows), keys=2)


def _estimated(units: list[UnitResult]) -> list[tuple[Which, int]]:
    """Which standard deviations are shown: those of Q, and those of R that were estimated."""
    out: list[tuple[Which, int]] = [("Q", i) for i in range(len(units[0].noise_names))]
    for i in range(len(units[0].output_names)):
        if units[0].R_true is not None and any(remark(u, "R", i) == "estimated" for u in units):
            out.append(("R", i))
    return out


def _of_what(rows: list[tuple[Cell, ...]], study: Study) -> str:
    names = {name for name, _, _ in study.results[0].output_names}
    return "" if any(row[1] in names for row in rows) else " of the process noise"


def _row(study: Study, units: list[UnitResult], which: Which, i: int) -> tuple[Cell, ...]:
    """The cells behind the method's name."""
    names = units[0].noise_names if which == "Q" else units[0].output_names
    truth = std(units[0].Q_true if which == "Q" else units[0].R_true, i)
    # Starts are averaged first: they share their data.
    per_replicate = [
        float(np.mean([std(covariances(u, "estimate")[0 if which == "Q" else 1], i) for u in same])) / truth - 1
        for same in group(units, lambda r: r.replicate).values()
    ]
    n = len(per_replicate)
    spread = float(np.std(per_replicate, ddof=1)) if n > 1 else math.nan
    why = "Fewer than two replicates converged"
    cells: tuple[Cell, ...] = (
        names[i][0], number(truth, "Not known"), names[i][1], n, number(100 * float(np.mean(per_replicate)), why),
        number(100 * spread / math.sqrt(n), why), number(100 * spread, why),
    )  # fmt: skip
    if not study.bounds:
        return cells
    bound = study.bounds.get(units[0].method_label, {}).get((_METRIC[which], names[i][0]), math.nan) / truth
    none = "There is no exact bound for what this method estimates"
    return (*cells, number(100 * bound, none), number(spread / bound, why if math.isfinite(bound) else none))

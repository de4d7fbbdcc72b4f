"""The process noise in both units: per sample, and as a density per root hertz."""

from __future__ import annotations

import numpy as np

from noiseid_cli.outcome import UnitResult
from noiseid_cli.report.reading import best, std
from noiseid_cli.report.study import Study
from noiseid_cli.report.tables import Cell, Column, Table, number

PER_ROOT_HERTZ = "/√Hz"


def unit_words(study: Study) -> str:
    """How the standard deviations of the process noise are to be read, for captions."""
    kinds = {r.density for r in study.results}
    return "as a density" if kinds == {True} else "per sample"


def noise_units_table(study: Study) -> Table | None:
    """Standard deviations per sample and per root hertz of the best units; None where nothing converts them."""
    rows: list[tuple[Cell, ...]] = []
    used = [r for r in best(study.results) if r.interval is not None]
    for r in used:
        per_sample, density = deviations(r)
        for i, (name, unit, _) in enumerate(r.noise_names):
            own = unit.removesuffix(PER_ROOT_HERTZ) or "1"
            why = f"Not available: the unit ended as {r.estimate.status}"
            values = (number(per_sample[i], why), own, number(density[i], why), f"{own}{PER_ROOT_HERTZ}")
            rows.append((r.unit, name, *values))
    if not rows:
        return None
    columns = (Column("Unit"), Column("Noise"), Column("Per sample"), Column("In"), Column("Density"), Column("In"))
    intervals = sorted({r.interval for r in used if r.interval is not None})
    at = " and ".join(f"{dt:g}" for dt in intervals)
    caption = (
        f"Standard deviations of the estimate for an interval of {at} s: covariance per sample = density / interval, "
        "the noise being held over each interval. The density is two-sided, and stays when the sample time changes."
    )
    return Table("noise-units", "Process noise per sample and as a density", caption, columns, tuple(rows), keys=2)


def deviations(result: UnitResult) -> tuple[list[float], list[float]]:
    """Standard deviations of the estimate per sample and as a density; the interval must be known."""
    assert result.interval is not None
    own = [std(result.estimate.final.Q, i) for i in range(len(result.noise_names))]
    root = float(np.sqrt(result.interval))
    return ([s / root for s in own], own) if result.density else (own, [s * root for s in own])

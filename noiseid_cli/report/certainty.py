"""How sure the estimates are: standard errors, intervals, and the directions that the data leave open."""

from __future__ import annotations

import math

from noiseid_cli.outcome import UnitResult
from noiseid_cli.report.reading import best
from noiseid_cli.report.study import Study
from noiseid_cli.report.tables import Cell, Column, Missing, Table, number, write_number


def certainty(result: UnitResult, metric: str, index: str) -> tuple[Cell, Cell]:
    """Standard error, and the interval as text, of one figure; missing with the reason."""
    found = result.uncertainty
    k = None if found is None else found.index(metric, index)
    if found is None or k is None:
        why = Missing("Held or known" if found is not None else _why_not(result))
        return why, why
    error = number(float(found.standard_errors[k]), found.notes[k] or "Not determined")
    return error, _interval(float(found.lower[k]), float(found.upper[k]))


def _why_not(result: UnitResult) -> str:
    told = next((text for text in result.estimate.safeguards if text.startswith("no standard errors")), "")
    return told.capitalize() or "No standard errors were asked for, or the unit failed"


def _interval(low: float, high: float) -> str:
    column = Column("", digits=3)
    ends = [str(write_number(v, column)) if math.isfinite(v) else "unbounded" for v in (low, high)]
    return " to ".join(ends)


def has_certainty(study: Study) -> bool:
    """Whether any unit has standard errors."""
    return any(r.uncertainty is not None for r in study.results)


def certainty_tables(study: Study) -> list[Table]:
    """Every figure of the best units with its error and interval, correlations among them."""
    tables = []
    units = [r for r in best(study.results) if r.uncertainty is not None]
    for n, r in enumerate(units, 1):
        found = r.uncertainty
        assert found is not None
        level = f"{100 * found.level:g} %"
        columns = (
            Column("Figure"),
            Column("Of"),
            Column("In"),
            Column("Estimate"),
            Column("Standard error", digits=3),
            Column(f"{level} interval"),
            Column("Note"),
        )
        rows = tuple(
            (
                metric.replace("_", " "),
                index,
                _unit(r, metric, index, unit) or "1",
                number(float(found.values[k]), "Not finite"),
                *certainty(r, metric, index),
                found.notes[k] or "–",
            )
            for k, (metric, index, unit) in enumerate(found.names)
        )
        caption = f"Unit {r.unit}. {_METHODS[found.method]}"
        tables.append(Table(f"uncertainty-{n}", f"How sure, {r.unit}", caption, columns, rows, keys=2))
    return tables


_METHODS = {
    "score": "From the observed information; intervals on the log of a standard deviation and on Fisher's z of a "
    "correlation, one-sided where zero is not excluded. They are about noise in the data, not about a wrong model.",
    "bootstrap": "From estimates of data simulated at the estimate in open loop; basic bootstrap intervals. They are "
    "about noise in the data, not about a wrong model.",
}


def _unit(result: UnitResult, metric: str, index: str, unit: str) -> str:
    """The unit in which the estimate is reported, which for a density is not the model's."""
    if metric == "process_noise_std":
        return next((u for name, u, _ in result.noise_names if name == index), unit)
    return unit


def certainty_sentences(study: Study) -> list[str]:
    """The weakest directions and the remarks of the best units, and why others have none."""
    out = []
    for r in best(study.results):
        found = r.uncertainty
        if found is not None:
            out += [f"{r.unit}: {text}" for text in dict.fromkeys((*found.remarks, *found.directions))]
        elif _why_not(r).startswith("No standard errors:"):
            out.append(f"{r.unit}: {_why_not(r)}.")
    return out


def ridges(study: Study) -> list[str]:
    """For the warnings: units in which some figures cannot be told."""
    out = []
    for r in best(study.results):
        if r.uncertainty is not None and r.uncertainty.remarks:
            out.append(f"{r.unit}: {r.uncertainty.remarks[0]}")
    return out

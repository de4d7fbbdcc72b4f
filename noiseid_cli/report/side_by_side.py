"""Scalar unknowns of several methods side by side, with the truth and with published estimates."""

from __future__ import annotations

import math

from noiseid_cli.outcome import UnitResult
from noiseid_cli.report.over_tests import over_tests
from noiseid_cli.report.over_time import over_time
from noiseid_cli.report.reading import group
from noiseid_cli.report.study import Study
from noiseid_cli.report.tables import Cell, Column, Missing, Table, number, write_number

MOST_METHODS = 4


def side_by_side(study: Study) -> Table | None:
    """One row for each unknown, one column for each method: of the first dataset, from the first start.

    None without at least two methods that estimated the same scalars.
    """
    units = compared(study)
    if len(units) < 2:
        return None
    first = units[0].estimate.parameters
    assert first is not None
    printed = study.estimates.methods if study.estimates else {}
    columns = [Column("Unknown"), Column("In"), Column("Start"), Column("Truth")]
    sampled = over_tests(units[0], "sampled_truth")
    columns += [Column("Sampled")] if sampled is not None else []
    columns += [Column(r.method_label) for r in units] + [Column(f"{label}, printed") for label in printed]
    rows: list[tuple[Cell, ...]] = []
    for i, (name, unit, _) in enumerate(first.names):
        row: list[Cell] = [name, unit or "1", number(float(first.start[i]), "No start"), _truth(units[0], i)]
        if sampled is not None:
            row.append(_sampled(units[0], name))
        row += [_estimate(r, i) for r in units]
        row += [_printed(values.get(name)) for values in printed.values()]
        rows.append(tuple(row))
    return Table("side-by-side", "Estimates side by side", _caption(study, units), tuple(columns), tuple(rows))


def compared(study: Study) -> list[UnitResult]:
    """The units that are set side by side: one for each method, of the same data, start and unknowns."""
    found = [r for r in study.results if r.estimate.parameters is not None and not over_time(r)]
    if not found or study.sweep:
        return []
    same = [
        r
        for r in found
        if r.dataset == found[0].dataset and r.start_index == found[0].start_index and _names(r) == _names(found[0])
    ]
    return [units[0] for units in group(same, lambda r: r.method_label).values()][:MOST_METHODS]


def _names(result: UnitResult) -> tuple[tuple[str, str, str], ...]:
    assert result.estimate.parameters is not None
    return result.estimate.parameters.names


def _truth(result: UnitResult, i: int) -> Cell:
    return number(
        None if result.parameters_true is None else float(result.parameters_true[i]), "The truth is not known"
    )


def _sampled(result: UnitResult, name: str) -> Cell:
    curve = over_tests(result, "sampled_truth")
    assert curve is not None
    columns = [column for column, _, _ in curve.columns]
    return float(curve.values[-1, columns.index(name)]) if name in columns else Missing("Not drawn anew in each test")


def _estimate(result: UnitResult, i: int) -> Cell:
    found = result.estimate.parameters
    assert found is not None
    error = None if found.standard_errors is None else float(found.standard_errors[i])
    return _written(float(found.final[i]), error)


def _printed(value: tuple[float, float | None] | None) -> Cell:
    return Missing("Not printed, or lost in print") if value is None else _written(*value)


def _written(value: float, error: float | None) -> str:
    text = str(write_number(value, Column("", digits=3)))
    known = error is not None and math.isfinite(error)
    return f"{text} ± {write_number(error, Column('', digits=2))}" if known and error is not None else text


def _caption(study: Study, units: list[UnitResult]) -> str:
    text = f"Of {units[0].dataset}; behind ± one standard error as the method reports it."
    if over_tests(units[0], "sampled_truth") is not None:
        text += " Sampled: moments of the first states that these tests really had, which no method sees."
    if study.estimates:
        text += f" Printed: {study.estimates.title} of {study.estimates.source}. {study.estimates.note}"
    return text.rstrip()

"""Published figures with ours beside them."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence

from noiseid_cli.report.reading import group
from noiseid_cli.report.study import PublishedFacts, Study
from noiseid_cli.report.tables import Cell, Column, Missing, Table, number
from noiseid_cli.report.tidy import metric_value

_STATISTICS: dict[str, Callable[[Sequence[float]], float]] = {
    "max": max,
    "min": min,
    "mean": statistics.fmean,
    "median": statistics.median,
    "std": statistics.stdev,
}


def published_tables(study: Study) -> list[Table]:
    """One table per published table: both figures, and both in units of the first method's, which need no unit."""
    return [_table(study, facts) for facts in study.published]


def published_sentences(study: Study) -> list[str]:
    """What the figures say of each method: does its end depend on the start, and how does it stand to the first one."""
    out = []
    for facts in study.published:
        if not {"max", "min"} <= set(facts.rows):
            continue
        first = next(iter(facts.rows["max"]))
        for method, highest in facts.rows["max"].items():
            ours, reference = (_values(study, facts, name) for name in (method, first))
            lowest = facts.rows["min"].get(method)
            if not ours or not reference or lowest is None or min(ours) <= 0 or min(reference) <= 0:
                continue
            text = f"{method}: largest over smallest {facts.title.lower()} is {max(ours) / min(ours):.4g} here"
            text += f", {highest / lowest:.4g} published"
            if method != first:
                text += (
                    f"; its smallest is {min(ours) / min(reference):.3g} times that of {first} here"
                    f", {lowest / facts.rows['min'][first]:.3g} times published"
                )
            out.append(f"{text}.")
    return out


def _values(study: Study, facts: PublishedFacts, method: str) -> list[float]:
    """Our figures of one method, one per unit that has one."""
    found = (metric_value(r, facts.metric, facts.index, study)[0] for r in study.results if r.method_label == method)
    return [value for value in found if value is not None]


def _table(study: Study, facts: PublishedFacts) -> Table:
    unit, ours = "", {}
    for method, units in group(study.results, lambda r: r.method_label).items():
        found = [metric_value(r, facts.metric, facts.index, study) for r in units]
        values = [value for value, _ in found if value is not None]
        unit = next((u for _, u in found if u), unit)
        ours[method] = values
    columns = (
        Column("Over the units"),
        Column("Method"),
        Column("Units"),
        Column("Ours", unit),
        Column("Published"),
        Column("Ours, relative", digits=3),
        Column("Published, relative", digits=3),
    )
    rows: list[tuple[Cell, ...]] = []
    for statistic, published in facts.rows.items():
        first = next(iter(published))
        base = _statistic(statistic, ours.get(first, []))
        for method, figure in published.items():
            own = _statistic(statistic, ours.get(method, []))
            relative = (
                number(own / base, "The reference is zero")
                if isinstance(own, float) and isinstance(base, float) and base != 0
                else Missing("No result of one of the two methods")
            )
            count = len(ours.get(method, []))
            rows.append((statistic, method, count, own, figure, relative, figure / published[first]))
    caption = (
        f"Unit of the published figures: {facts.unit}. Relative: over the figure of the first method in the same row "
        f"of the source. {facts.note} Source: {facts.source}."
    )
    return Table(
        f"published-{facts.name}", f"{facts.title}, ours beside the published", caption, columns, tuple(rows), 2
    )


def _statistic(name: str, values: Sequence[float]) -> Cell:
    if len(values) < (2 if name == "std" else 1):
        return Missing("No result of this method")
    return number(float(_STATISTICS[name](values)), "Not a finite number")

"""Which tables a study has: what was estimated, before and after, standard deviations, correlations."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal

import numpy as np

from noiseid_cli.outcome import UnitResult
from noiseid_cli.report.before_after import has_path, nis, path_error
from noiseid_cli.report.certainty import certainty, has_certainty
from noiseid_cli.report.noise_units import unit_words
from noiseid_cli.report.reading import (
    PLACES,
    best,
    converged,
    correlation,
    covariances,
    group,
    loglik,
    reason,
    remark,
    std,
)
from noiseid_cli.report.shown import KIND
from noiseid_cli.report.study import Study
from noiseid_cli.report.tables import Cell, Column, Missing, Table, number

MANY = 12
"""With more units than this, tables with several rows per unit give way to means over units."""

Which = Literal["Q", "R"]
WORDS: dict[Which, str] = {"Q": "process noise", "R": "measurement noise"}


def ending_table(study: Study) -> Table:
    """How each unit ended: status, passes, time and the reason in words."""
    columns = (
        Column("Unit"),
        Column("Start"),
        Column("Status"),
        Column("Passes"),
        Column("Time", "s", digits=3),
        Column("Reason"),
    )
    rows = tuple(
        (
            r.unit,
            r.start_label,
            r.estimate.status,
            r.estimate.passes,
            number(r.estimate.seconds, "Not timed"),
            r.estimate.reason,
        )
        for r in study.results
    )
    return Table(
        "endings",
        "How each unit ended",
        "A pass takes in all data once.",
        columns,
        rows,
    )


def summary_table(study: Study) -> Table:
    """Per method, means over the converged units, with the number used and the number of all."""
    columns: tuple[Column, ...] = (
        Column("Method"),
        Column("Converged / all"),
        Column("Passes", decimals=1),
        Column("Time", "s", digits=3),
        Column("Log-likelihood gained", decimals=2),
        Column("NIS, estimate"),
        Column("Path error, estimate", study.path_unit()),
    )
    readers: list[Callable[[UnitResult], float]] = [
        lambda r: float(r.estimate.passes),
        lambda r: r.estimate.seconds,
        lambda r: loglik(r, "estimate") - loglik(r, "start"),
        lambda r: nis(r, "estimate"),
        lambda r: path_error(r, "estimate"),
    ]
    if not any(has_path(r) for r in study.results):
        columns, readers = columns[:-1], readers[:-1]
    rows = []
    for method, units in group(study.results, lambda r: r.method_label).items():
        used = [u for u in units if converged(u)]
        means = [_mean([read(u) for u in used]) for read in readers]
        rows.append((method, f"{len(used)} / {len(units)}", *means))
    caption = "Means over the units that converged; the others are counted but not averaged."
    return Table("summary", "Means per method", caption, columns, tuple(rows))


def _mean(values: list[float]) -> Cell:
    if not values:
        return Missing("No unit converged")
    return number(sum(values) / len(values), "Not available for every unit that converged")


_FATES = {
    "held": " Held: given in the experiment and left alone.",
    "unchanged": " Unchanged: the whole unit ended at its start.",
}


def std_table(study: Study, which: Which) -> Table:
    """Standard deviations at start, estimate and truth, unit by unit, with what was held marked."""
    index = 0 if which == "Q" else 1
    known = any((r.Q_true, r.R_true)[index] is not None for r in study.results)
    columns = [Column("Unit"), Column("Noise"), Column("In"), Column("Start"), Column("Estimate")]
    sure = has_certainty(study)
    columns += [Column("±", digits=2), Column("Interval")] if sure else []
    stepped = which == "R" and any(_steps(study, r) for r in study.results)
    columns += [Column("In steps", digits=3)] if stepped else []
    columns += [Column("Truth"), Column("Estimate / truth")] if known else []
    rows: list[tuple[Cell, ...]] = []
    for r in study.results:
        names = r.noise_names if which == "Q" else r.output_names
        for i, (name, unit, _) in enumerate(names):
            start, end, truth = (std(covariances(r, at)[index], i) for at in PLACES)
            beside = (number(truth, reason(r, "truth")), _ratio(end, truth, reason(r, "truth"))) if known else ()
            values: tuple[Cell, ...] = (number(start, reason(r, "start")), number(end, reason(r, "estimate")))
            values += certainty(r, f"{WORDS[which].replace(' ', '_')}_std", name) if sure else ()
            if stepped:
                step = _steps(study, r).get(name)
                values += (number(None if step is None else end / step, "The output does not move in steps"),)
            rows.append((r.unit, name, unit or "1", *values, *beside, remark(r, which, i)))
    columns.append(KIND)
    caption = f"Square roots of the diagonal of {which}, {_words(study, which)}." + "".join(
        text for kind, text in _FATES.items() if any(row[-1] == kind for row in rows)
    )
    levels = sorted({r.uncertainty.level for r in study.results if r.uncertainty is not None})
    if levels:
        shares = " or ".join(f"{100 * level:g}\u00a0%" for level in levels)
        caption += f" ±: standard error. Interval: {shares}."
    if stepped:
        caption += " In steps: the estimate over the quantisation step of the output; rounding alone is 0.29."
    kind = WORDS[which]
    name = f"std-{kind.replace(' ', '-')}"
    return Table(name, f"Standard deviations of the {kind}", caption, tuple(columns), _merge_held(rows), keys=2)


def _steps(study: Study, result: UnitResult) -> dict[str, float]:
    """The quantisation steps of a unit's outputs."""
    data = study.dataset(result.dataset)
    return {} if data is None else data.steps


def _words(study: Study, which: Which) -> str:
    return unit_words(study) if which == "Q" else "per sample"


def _ratio(value: float, reference: float, why_not: str) -> Cell:
    return Missing("The reference is zero") if reference == 0 else number(value / reference, why_not)


def _merge_held(rows: list[tuple[Cell, ...]]) -> tuple[tuple[Cell, ...], ...]:
    """One row for all units where a table holds nothing but held values, the same for each unit."""
    distinct = dict.fromkeys(row[1:] for row in rows)
    names = {row[1] for row in rows}
    if len(distinct) == len(names) < len(rows) and all(row[-1] == "held" for row in rows):
        return tuple(("all", *row) for row in distinct)
    return tuple(rows)


def std_summary_table(study: Study, which: Which) -> Table:
    """Mean and spread of the standard deviations over the converged units of each method."""
    index = 0 if which == "Q" else 1
    columns = [Column("Method"), Column("Noise"), Column("In"), Column("Converged / all"), Column("Mean")]
    columns += [Column("Spread"), Column("Mean of estimate / truth"), KIND]
    rows = []
    for method, units in group(study.results, lambda r: r.method_label).items():
        used = [u for u in units if converged(u)]
        names = units[0].noise_names if which == "Q" else units[0].output_names
        for i, (name, unit, _) in enumerate(names):
            ends = [std(covariances(u, "estimate")[index], i) for u in used]
            truths = [std(covariances(u, "truth")[index], i) for u in used]
            ratios = [e / t if t > 0 else float("nan") for e, t in zip(ends, truths, strict=True)]
            mean = _mean(ratios) if any(math.isfinite(t) for t in truths) else Missing("The truth is not known")
            kinds = ", ".join(sorted({remark(u, which, i) for u in used})) or "–"
            head = (method, name, unit or "1", f"{len(used)} / {len(units)}")
            rows.append((*head, _mean(ends), _spread(ends), mean, kinds))
    kind = WORDS[which]
    words = _words(study, which)
    caption = f"Mean and standard deviation over the converged units, {words}; every unit is in results.csv."
    title = f"Standard deviations of the {kind}, means"
    return Table(f"std-{kind.replace(' ', '-')}-means", title, caption, tuple(columns), tuple(rows), keys=2)


def _spread(values: list[float]) -> Cell:
    if len(values) < 2:
        return Missing("Fewer than two units converged")
    if min(values) == max(values):
        return 0.0
    mean = sum(values) / len(values)
    return number((sum((v - mean) ** 2 for v in values) / (len(values) - 1)) ** 0.5, "Not available for every unit")


def correlation_tables(study: Study) -> list[Table]:
    """Correlations of the estimated process noise, for the best unit of each dataset and method; none if all are 0."""
    tables = []
    for n, r in enumerate(best(study.results), 1):
        names = [name for name, _, _ in r.noise_names]
        if np.count_nonzero(r.estimate.final.Q) <= len(names):
            continue
        rho = correlation(r.estimate.final.Q)
        rows = tuple(
            (name, *(number(float(v), "The variance is zero or not known") for v in rho[i]))
            for i, name in enumerate(names)
        )
        columns = (Column("Noise"), *(Column(name, decimals=3) for name in names))
        caption = f"Unit {r.unit}, {r.estimate.status}. 0: independent; near ±1: they act as one."
        if r.Q_true is not None and np.all(np.isfinite(rho)):
            caption += f" Largest difference from the truth: {np.nanmax(np.abs(rho - correlation(r.Q_true))):.3f}."
        tables.append(
            Table(
                f"correlation-{n}",
                f"Correlations of the process noise, {r.method_label}",
                caption,
                columns,
                rows,
            )
        )
    return tables

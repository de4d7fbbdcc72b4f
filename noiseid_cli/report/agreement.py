"""Tables of agreement: of the filter with the data, and of the starts with each other."""

from __future__ import annotations

import math

from noiseid_cli.models.recording import Array
from noiseid_cli.outcome import UnitResult
from noiseid_cli.report.diagnosis import output_cells
from noiseid_cli.report.reading import (
    PLACES,
    At,
    best,
    converged,
    covariances,
    evaluation,
    group,
    loglik,
    reason,
    std,
)
from noiseid_cli.report.study import Study
from noiseid_cli.report.tables import Cell, Column, Missing, Table, number

SAME_OPTIMUM = 0.1
"""Ends this close in log-likelihood are called the same: the data cannot tell them apart."""

NAMED = 5
"""At most so many starts are named in a sentence."""


def consistency_table(study: Study) -> Table:
    """NIS per output at the start, at the estimate and at the truth; whiteness, bands and tails at the estimate.

    Of the best unit of each dataset and method.
    """
    units = best(study.results)
    truth = any("truth" in r.evaluations for r in units)
    columns = [Column("Unit"), Column("Output"), Column("NIS, start"), Column("NIS, estimate")]
    columns += [Column("NIS, truth")] if truth else []
    columns += [Column("In 95 % band", "%", digits=3), Column("Ljung-Box p", digits=2)]
    columns += [Column("Strongest correlation", decimals=2), Column("at lag")]
    columns += [Column("Excess kurtosis", digits=3), Column("Normality p", digits=2)]
    rows = []
    for r in units:
        for i, (name, _, _) in enumerate(r.output_names):
            nis = [_entry(r, at, "nis_output", i) for at in (PLACES if truth else PLACES[:2])]
            found = evaluation(r, "estimate")
            rest = output_cells(found, i)[1:] if found else (number(None, reason(r, "estimate")),) * 6
            rows.append((r.unit, name, *nis, *rest))
    caption = (
        "NIS: mean squared innovation over its predicted variance, 1 for a consistent filter, above 1 for an "
        "over-confident one. All else at the estimate. Ljung-Box p: small for innovations that are not white. Excess "
        "kurtosis: 0 for Gaussian innovations, positive for heavy tails. Normality p (Jarque and Bera): small for "
        "innovations that are not Gaussian, and too small where they are not white."
    )
    filters = {r.method_label: found.filter for r in units if (found := evaluation(r, "estimate")) is not None}
    if set(filters.values()) - {"extended"}:
        caption += f" Filter: {'; '.join(f'{name} for {label}' for label, name in filters.items())}."
        caption += " Log-likelihoods of different filters are different approximations."
    if len(units) < len(study.results):
        caption += f" Of {len(study.results)} units the best of each method and dataset; results.csv holds all."
    return Table("consistency", "Innovations per output", caption, tuple(columns), tuple(rows), keys=2)


def _entry(result: UnitResult, at: At, field: str, i: int) -> Cell:
    found = evaluation(result, at)
    if found is None:
        return number(None, reason(result, at))
    values: Array = getattr(found, field)
    return number(float(values[i]), "Too few measurements" if found.observed else "Nothing was measured")


def start_groups(study: Study) -> list[list[UnitResult]]:
    """Units that differ in nothing but their start, where there are several."""
    groups = group(study.results, lambda r: (r.dataset, r.replicate, r.method_label)).values()
    return [units for units in groups if len({u.start_index for u in units}) > 1]


def starts_table(study: Study) -> Table:
    """Spread of the ends over the starts, in log-likelihood and in each standard deviation."""
    names = list(dict.fromkeys(name for r in study.results for name, _, _ in r.noise_names))
    columns = [Column("Method"), Column("Dataset"), Column("Replicate"), Column("Converged / all")]
    columns += [
        Column("Log-likelihood", digits=3),
        *(Column(f"Std {n}", "%", digits=3) for n in names),
    ]
    rows = []
    for units in start_groups(study):
        used = [u for u in units if converged(u)]
        cells = [_std_spread(used, name) for name in names]
        head = (units[0].method_label, units[0].dataset, units[0].replicate, f"{len(used)} / {len(units)}")
        rows.append((*head, _loglik_spread(used), *cells))
    caption = (
        "Largest minus smallest over the starts that converged; for standard deviations relative to their mean. "
        f"Ends within {SAME_OPTIMUM:g} of log-likelihood are the same optimum for all the data can tell."
    )
    return Table("starts", "Spread over the starts", caption, tuple(columns), tuple(rows), keys=3)


def start_sentences(study: Study) -> list[str]:
    """Per method, in how many groups all starts ended at one optimum."""
    out = []
    for method, groups in _by_method(start_groups(study)).items():
        spreads = [(_loglik_spread([u for u in units if converged(u)]), units) for units in groups]
        compared = [(s, units) for s, units in spreads if isinstance(s, float)]
        if not compared:
            out.append(f"{method}: fewer than two starts converged, so nothing can be compared.")
            continue
        same = sum(s <= SAME_OPTIMUM for s, _ in compared)
        worst = max(s for s, _ in compared)
        where = "" if len(groups) == 1 else f" in {same} of {len(groups)} datasets"
        failed = sum(not converged(u) for units in groups for u in units)
        text = f"{method}: the starts end at the same optimum{where}" if same else f"{method}: the starts end apart"
        text += f"; the largest spread of log-likelihood is {worst:.3g}."
        out.append(text + (f" {failed} that did not converge are left out." if failed else ""))
        out += [told for units in groups if (told := _elsewhere(units))]
    return out


def _elsewhere(units: list[UnitResult]) -> str:
    """Which starts of one dataset ended below the best, the farthest first, and which did not converge."""
    used = [u for u in units if converged(u)]
    top = max((loglik(u, "estimate") for u in used), default=math.nan)
    below = sorted((loglik(u, "estimate") - top, u.start_label) for u in used)
    parts = [f"{label} ({gap:.3g})" for gap, label in below if gap < -SAME_OPTIMUM]
    shown = parts[:NAMED] + ([f"{len(parts) - NAMED} more"] if len(parts) > NAMED else [])
    told = f"these starts ended below the best: {', '.join(shown)}" if parts else ""
    failed = [f"{u.start_label} ({u.estimate.status})" for u in units if not converged(u)]
    others = f"these did not converge: {', '.join(failed[:NAMED])}" if failed else ""
    where = f"{units[0].method_label} on {units[0].dataset}: "
    return where + "; ".join(part for part in (told, others) if part) + "." if told or others else ""


def _by_method(groups: list[list[UnitResult]]) -> dict[str, list[list[UnitResult]]]:
    out: dict[str, list[list[UnitResult]]] = {}
    for units in groups:
        out.setdefault(units[0].method_label, []).append(units)
    return out


def _loglik_spread(used: list[UnitResult]) -> Cell:
    if len(used) < 2:
        return Missing("Fewer than two starts converged")
    ends = [loglik(u, "estimate") for u in used]
    return number(max(ends) - min(ends), "A log-likelihood is not finite")


def _std_spread(used: list[UnitResult], name: str) -> Cell:
    if len(used) < 2:
        return Missing("Fewer than two starts converged")
    names = [n for n, _, _ in used[0].noise_names]
    if name not in names:
        return Missing("This dataset's model has no such noise")
    ends = [std(covariances(u, "estimate")[0], names.index(name)) for u in used]
    mean = sum(ends) / len(ends)
    return number(100 * (max(ends) - min(ends)) / mean if mean > 0 else 0.0, "A standard deviation is not known")

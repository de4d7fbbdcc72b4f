"""Does a filter agree with its data, in tables and sentences: on the whole, per output, and where in the motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from noiseid_cli.diagnostics.evaluation import Evaluation
from noiseid_cli.diagnostics.misfit import held_out_sentences, misfit_sentences
from noiseid_cli.diagnostics.where import Misfit
from noiseid_cli.outcome import Columns, UnitResult
from noiseid_cli.report.tables import Cell, Column, Missing, Table, number


@dataclass(frozen=True)
class Case:
    """A filter with several noise values against one dataset.

    Attributes:
        name: what it is called in tables.
        outputs: the model's outputs.
        evaluations: by label, on the data that was fitted (or given).
        held_out: by label, on data that no method has seen.
        interval: between samples, s; None where it is not known.
    """

    name: str
    outputs: Columns
    evaluations: dict[str, Evaluation]
    held_out: dict[str, Evaluation] = field(default_factory=dict)
    interval: float | None = None


def case_of(result: UnitResult, interval: float | None = None) -> Case:
    """The case of a unit's result."""
    return Case(result.unit, result.output_names, result.evaluations, result.held_out, interval)


def overall_table(cases: Sequence[Case]) -> Table:
    """NIS with its chi-square bounds, and NEES where the truth is known, on fitted and on held-out data."""
    known = any(math.isfinite(e.nees) for c in cases for e in c.evaluations.values())
    columns = [Column("Unit"), Column("Data"), Column("Filter at"), Column("Log-likelihood", decimals=2), Column("NIS")]
    columns += [Column("Bounds")]
    columns += [Column("NEES"), Column("NEES in bounds", "%", digits=3)] if known else []
    rows: list[tuple[Cell, ...]] = []
    for case in cases:
        for data, found in (("fitted", case.evaluations), ("held out", case.held_out)):
            for at, e in found.items():
                low, high = e.nis_bounds()
                bounds = f"{low:.3f} to {high:.3f}" if e.observed else "none"
                row: list[Cell] = [case.name, data, at, number(e.loglik, "Not finite"), number(e.nis, "Not measured")]
                row.append(bounds)
                if known:
                    row += [number(e.nees, "No truth"), number(100 * e.nees_inside(), "No truth")]
                rows.append(tuple(row))
    caption = (
        "NIS: mean normalised innovation squared per measurement; a consistent filter is within the bounds in 95 of "
        "100 cases. On fitted data it proves nothing: free covariances reach 1 at any optimum."
    )
    if known:
        caption += " NEES: the same of the estimation errors per state; 95 % of the samples should be in their bounds."
    return Table("agreement", "Filter and data", caption, tuple(columns), tuple(rows), keys=3)


def output_table(cases: Sequence[Case], at: str) -> Table:
    """Whiteness, distribution and bands of the innovations, output by output, at one set of noise values."""
    columns = (
        Column("Unit"),
        Column("Output"),
        Column("NIS"),
        Column("In 95 % band", "%", digits=3),
        Column("Ljung-Box p", digits=2),
        Column("Strongest correlation", decimals=2),
        Column("at lag"),
        Column("Excess kurtosis", digits=3),
        Column("Normality p", digits=2),
    )
    rows = tuple(
        (case.name, name, *output_cells(case.evaluations[at], i))
        for case in cases
        if at in case.evaluations
        for i, (name, _, _) in enumerate(case.outputs)
    )
    caption = (
        f"Filter at: {at}. Ljung-Box p: small for innovations that are not white; normality p (Jarque and Bera): small "
        "for innovations that are not Gaussian, and too small where they are not white."
    )
    return Table(f"innovations-{at}", f"Innovations per output, {at}", caption, columns, rows, keys=2)


def output_cells(e: Evaluation, i: int) -> tuple[Cell, ...]:
    """NIS, share in the band, Ljung-Box p, strongest correlation and its lag, kurtosis, normality of output i."""
    rho = [(abs(float(v)), lag) for lag, v in enumerate(e.autocorrelation[:, i], 1) if math.isfinite(float(v))]
    why = "Not measured"
    strongest: tuple[Cell, Cell] = (Missing(why), Missing(why))
    if rho:
        lag = max(rho)[1]
        strongest = float(e.autocorrelation[lag - 1, i]), lag
    inside = None if e.inside is None else 100 * float(e.inside[i])
    normality = None if e.normality is None else float(e.normality[i])
    return (
        number(float(e.nis_output[i]), why),
        number(inside, why),
        number(float(e.ljung_box[i]), why),
        *strongest,
        number(float(e.kurtosis[i]), why),
        number(normality, why),
    )


def where_table(cases: Sequence[Case], at: str) -> Table | None:
    """The quantity ranges with most misfit, for each time, state and input; None where nothing was measured."""
    columns = (
        Column("Unit"),
        Column("Against"),
        Column("Unevenness", "%", digits=3),
        Column("Worst range"),
        Column("In"),
        Column("NIS there"),
    )
    rows: list[tuple[Cell, ...]] = []
    for case in cases:
        found = case.evaluations.get(at)
        if found is None:
            continue
        for misfit in sorted(found.misfit, key=lambda m: -m.unevenness):
            low, high, nis = misfit.worst()
            cells = (100 * misfit.unevenness, f"{low:.3g} to {high:.3g}", misfit.unit or "1", nis)
            rows.append((case.name, misfit.name, *cells))
    caption = (
        f"Filter at: {at}. Each quantity is cut into ten ranges of equally many samples; unevenness is the scatter of "
        "their NIS over its mean, with chance taken away. Misfit that follows a quantity points at "
        "the model's terms in it."
    )
    table = Table(f"where-{at}", f"Where the misfit sits, {at}", caption, columns, tuple(rows), keys=2)
    return table if rows else None


def verdict(case: Case, at: str) -> list[str]:
    """What is left unexplained at one set of noise values, and whether it carries over to held-out data."""
    found = case.evaluations.get(at)
    if found is None:
        return [f"The filter was not evaluated at the {at} values: it failed there."]
    out = misfit_sentences(found, [name for name, _, _ in case.outputs], case.interval)
    return out + held_out_sentences(found, case.held_out)


def misfit_curves(case: Case, at: str) -> tuple[Misfit, ...]:
    """The quantities that the misfit follows most, at most four."""
    found = case.evaluations.get(at)
    return tuple(sorted(found.misfit, key=lambda m: -m.unevenness)[:4]) if found else ()

"""The one table that everything else derives from: a row per unit, metric and index, in full precision."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from noiseid_cli.diagnostics.evaluation import Evaluation
from noiseid_cli.models.recording import Array
from noiseid_cli.outcome import UnitResult
from noiseid_cli.report.over_time import over_time, track, tracked_names
from noiseid_cli.report.reading import (
    ALL_PLACES,
    At,
    Names,
    correlation,
    covariance_unit,
    covariances,
    loglik,
    reason,
    std,
)
from noiseid_cli.report.study import Study
from noiseid_cli.report.tables import Cell, Column, Missing, Table, number
from noiseid_cli.report.tracking import late_errors

_HEAD = ("unit", "dataset", "method", "start", "start_label", "replicate", "status")
_TAIL = ("at", "metric", "index", "value", "value_unit", "note")

Row = tuple[str, str, str, float, str]
"""at, metric, index, value, unit of the value."""


def tidy_table(study: Study) -> Table:
    """All numbers of a study in long form; a value may be empty.

    ``at`` is tuning, start, estimate, truth, one of them with held_out_ before it, or empty.
    Of a sweep, each axis has a column of its own, ``sweep_`` and its name, between the unit and the number.
    """
    rows = []
    for result in study.results:
        head: tuple[Cell, ...] = (
            result.unit,
            result.dataset,
            result.method_label,
            result.start_index,
            result.start_label,
            result.replicate,
            result.estimate.status,
        )
        swept = study.sweep.values[result.unit] if study.sweep else ()
        for at, metric, index, value, unit in _rows(result, study):
            cell = value if isinstance(value, int) else number(value, "")
            note = reason(result, "truth" if at == "truth" else "estimate") if isinstance(cell, Missing) else ""
            rows.append((*head, *swept, at, metric, index, cell, unit, note))
    caption = "One row per unit, place (at), metric and index."
    axes = tuple(f"sweep_{axis}" for axis in study.sweep.axes) if study.sweep else ()
    headings = (*_HEAD, *axes, *_TAIL)
    return Table("results", "All results", caption, tuple(Column(h) for h in headings), tuple(rows))


def _rows(result: UnitResult, study: Study) -> Iterator[Row]:
    yield "", "passes", "", result.estimate.passes, ""
    yield "", "seconds", "", result.seconds, "s"
    yield "", "estimation_seconds", "", result.estimate.seconds, "s"
    yield "", "seed", "", result.seed, ""
    yield from _parameter_rows(result)
    yield from _tracking_rows(result)
    yield from _certainty_rows(result)
    for at in ALL_PLACES:
        yield from _covariance_rows(result, at)
        found = result.evaluations.get(at)
        if found is not None:
            yield from _evaluation_rows(result, at, found, study.path_unit())
        elif at in ("start", "estimate"):
            yield at, "loglik", "", loglik(result, at), ""
    for label, found in result.held_out.items():
        yield from _evaluation_rows(result, f"held_out_{label}", found, study.path_unit())


def _tracking_rows(result: UnitResult) -> Iterator[Row]:
    """Errors of unknowns that move over time, relative to the truth, over the last part of the time."""
    for name in tracked_names([result]) if over_time(result) else ():
        found = track(result, name)
        if found is not None:
            error = late_errors(found)
            yield "estimate", "tracking_bias", name, float(np.mean(error)), ""
            yield "estimate", "tracking_rmse", name, float(np.mean(error**2)) ** 0.5, ""


def _parameter_rows(result: UnitResult) -> Iterator[Row]:
    found = result.estimate.parameters
    if found is None:
        return
    for i, (name, unit, _) in enumerate(found.names):
        yield "start", "parameter", name, float(found.start[i]), unit
        yield "estimate", "parameter", name, float(found.final[i]), unit
        # One among the figures of the uncertainty has its standard error there.
        told = result.uncertainty is not None and result.uncertainty.index("parameter", name) is not None
        if found.standard_errors is not None and not told:
            yield "estimate", "parameter_standard_error", name, float(found.standard_errors[i]), unit
        if result.parameters_true is not None:
            yield "truth", "parameter", name, float(result.parameters_true[i]), unit


def _certainty_rows(result: UnitResult) -> Iterator[Row]:
    found = result.uncertainty
    if found is None:
        return
    units = {name: unit for name, unit, _ in result.noise_names}
    for k, (metric, index, own) in enumerate(found.names):
        unit = units.get(index, own) if metric == "process_noise_std" else own
        yield "estimate", f"{metric}_standard_error", index, float(found.standard_errors[k]), unit
        yield "estimate", f"{metric}_lower", index, float(found.lower[k]), unit
        yield "estimate", f"{metric}_upper", index, float(found.upper[k]), unit


def _covariance_rows(result: UnitResult, at: At) -> Iterator[Row]:
    Q, R = covariances(result, at)
    if Q is not None:
        yield from _matrix_rows(at, "process_noise", Q, result.noise_names)
    if R is not None:
        yield from _matrix_rows(at, "measurement_noise", R, result.output_names)


def _matrix_rows(at: At, kind: str, covariance: Array, names: Names) -> Iterator[Row]:
    rho = correlation(covariance)
    for i, (name, unit, _) in enumerate(names):
        yield at, f"{kind}_std", name, std(covariance, i), unit
        for j in range(i + 1):
            pair = f"{name}, {names[j][0]}"
            yield at, f"{kind}_covariance", pair, float(covariance[i, j]), covariance_unit(names, i, j)
            if j < i:
                yield at, f"{kind}_correlation", pair, float(rho[i, j]), ""


def metric_value(result: UnitResult, metric: str, index: str, study: Study) -> tuple[float | None, str]:
    """One figure of the estimate as results.csv has it, and its unit; None where there is no such figure."""
    for at, name, entry, value, unit in _rows(result, study):
        if (at, name, entry) in (("estimate", metric, index), ("", metric, index)):
            return float(value), unit
    return None, ""


def _evaluation_rows(result: UnitResult, at: str, found: Evaluation, path_unit: str) -> Iterator[Row]:
    yield at, "loglik", "", found.loglik, ""
    yield at, "observed", "", found.observed, ""
    yield at, "nis", "", found.nis, ""
    low, high = found.nis_bounds()
    yield at, "nis_lower_bound", "", low, ""
    yield at, "nis_upper_bound", "", high, ""
    if found.nees_time is not None:
        yield at, "nees", "", found.nees, ""
        yield at, "nees_inside", "", found.nees_inside(), ""
    if found.path_error is not None:
        yield at, "path_error_norm", "", found.path_error_norm, path_unit
    for i, (name, _, _) in enumerate(result.output_names):
        yield at, "nis_output", name, float(found.nis_output[i]), ""
        yield at, "ljung_box_p", name, float(found.ljung_box[i]), ""
        yield at, "kurtosis", name, float(found.kurtosis[i]), ""
        if found.inside is not None and found.normality is not None:
            yield at, "inside_band", name, float(found.inside[i]), ""
            yield at, "normality_p", name, float(found.normality[i]), ""
        for lag, rho in enumerate(found.autocorrelation[:, i], 1):
            yield at, "autocorrelation", f"{name}, {lag}", float(rho), ""
    for misfit in found.misfit:
        yield at, "misfit_unevenness", misfit.name, misfit.unevenness, ""
        for k, nis in enumerate(misfit.nis, 1):
            yield at, "misfit_nis", f"{misfit.name}, {k}", float(nis), ""
            yield at, "misfit_upper_border", f"{misfit.name}, {k}", float(misfit.edges[k]), misfit.unit

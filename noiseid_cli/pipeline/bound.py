"""The Cramer-Rao bound beside the spread over replicates, where it is exact: linear models with a known truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from noiseid_cli.errors import NoiseidError
from noiseid_cli.pipeline.assessment import fitted_part
from noiseid_cli.pipeline.context import Context
from noiseid_cli.pipeline.estimation import in_unit_of_estimate, selected, with_structure
from noiseid_cli.pipeline.evaluating import candidates, compiled_at
from noiseid_cli.pipeline.first_state import first_names
from noiseid_cli.pipeline.methods import ENSEMBLES
from noiseid_cli.pipeline.problem import pose
from noiseid_cli.pipeline.unit import EstimateUnit

if TYPE_CHECKING:
    from noiseid_cli.models.recording import Dataset
    from noiseid_cli.outcome import UnitResult

Bounds = dict[str, dict[tuple[str, str], float]]
"""By method label, then by metric and index: the least standard error of an unbiased estimate."""


def bounds(
    context: Context,
    units: Sequence[EstimateUnit],
    results: Mapping[Path, UnitResult],
    data: Mapping[Path, Dataset],
) -> Bounds:
    """The bound for each method, at the truth of its first replicate.

    A method has none whose model is nonlinear, whose unknowns go beyond noise values, or whose data are gated.

    Args:
        context: the experiment.
        units: those that are done.
        results, data: results and datasets by their files.
    """
    section = context.experiment.estimate
    simulate = context.experiment.simulate
    if section is None or simulate is None or simulate.replicates < 2 or context.points:
        return {}
    if section.parameters or section.outlier_gate is not None or context.model.discretisation == "van_loan":
        return {}
    first: dict[str, EstimateUnit] = {}
    for unit in units:
        if unit.path in results and unit.dataset.path in data and unit.options.method not in ENSEMBLES:
            first.setdefault(unit.label, unit)
    found = {k: _of_unit(context, u, results[u.path], data[u.dataset.path]) for k, u in first.items()}
    return {label: bound for label, bound in found.items() if bound}


def _of_unit(
    context: Context, unit: EstimateUnit, result: UnitResult, dataset: Dataset
) -> dict[tuple[str, str], float]:
    """The bound for one unit; empty where there is none."""
    import numpy as np

    from noiseid_cli.estimators.expected_information import cramer_rao

    section = context.experiment.estimate
    assert section is not None
    used = selected(context, in_unit_of_estimate(context, dataset))
    try:
        _, unknowns = pose(with_structure(section, unit.options), used, context.compiled, first=first_names(context))
        model, noise = candidates(context, used, result.estimate)["truth"]
        recordings = fitted_part(section, used).recordings
        return cramer_rao(compiled_at(context, model), recordings, noise, unknowns)
    except (NoiseidError, KeyError, np.linalg.LinAlgError):
        return {}

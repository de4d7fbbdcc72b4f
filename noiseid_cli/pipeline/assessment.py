"""What the methods see of a dataset, and how sure they are of what they made of it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from noiseid_cli.errors import NoiseidError

if TYPE_CHECKING:
    from noiseid_cli.config.method_base import MethodOptions
    from noiseid_cli.config.schema_estimate import Estimate as Section
    from noiseid_cli.estimators.estimate import Estimate, Uncertainty
    from noiseid_cli.models.recording import Array, Dataset
    from noiseid_cli.pipeline.methods import Task

# Shares of the complete-data information: nothing, and more than there can be [chosen].
NOTHING, TOO_MUCH = 1e-6, 1.5

ASSESSED = ("converged", "max_passes", "stalled_fixed_point")
"""Standard errors are asked of ends with these statuses."""


def fitted_part(section: Section | None, dataset: Dataset) -> Dataset:
    """What the methods see of a dataset: each test without the end that is held out."""
    from noiseid_cli.models.recording import head

    if section is None or section.holdout is None:
        return dataset
    cut = [head(r, _fitted_samples(section, r.samples)) for r in dataset.recordings]
    share = f"{100 * section.holdout.last:g} %"
    note = f"the last {share} of each test were held out: no method saw them"
    return replace(dataset, recordings=tuple(cut), notes=(*dataset.notes, note))


def _fitted_samples(section: Section, samples: int) -> int:
    """Number of samples of a test that are fitted; at least one, and at least one is left."""
    assert section.holdout is not None
    return min(max(math.ceil((1.0 - section.holdout.last) * samples), 1), max(samples - 1, 1))


def assess_uncertainty(
    section: Section, options: MethodOptions, task: Task, estimate: Estimate, seed: tuple[int, ...]
) -> tuple[Uncertainty | None, tuple[str, ...]]:
    """Standard errors of an estimate as the experiment asks for them, and why there are none.

    Args:
        section: the experiment's `estimate` section.
        options: the method's options.
        task: what the method was given, with the model at the estimate's parameter values.
        estimate: what it ended with.
        seed: seed and position of the unit, for the bootstrap.
    """
    import numpy as np

    from noiseid_cli.estimators import em
    from noiseid_cli.estimators.parameter_errors import only_parameters, with_parameters
    from noiseid_cli.estimators.uncertainty import uncertainty
    from noiseid_cli.pipeline.bootstrap import bootstrap

    choice, name = section.uncertainty, options.method
    u, own = task.unknowns, estimate.parameters
    noise = bool(u.Q or u.R or u.P0 or u.m0)
    if choice.method == "none" or estimate.status not in ASSESSED or not (noise or own):
        return None, ()
    try:
        if choice.method == "bootstrap":
            return bootstrap(name, task, estimate, choice.replicates or 100, choice.level, seed), ()
        if not options.has_score:
            return None, _without_score(name, estimate)
        if name == "ml":
            found = _of_ml(task, estimate, choice.level) if noise else only_parameters(choice.level)
            return (found if own is None else with_parameters(found, own)), ()
        passes = em.EmOptions(**task.options)
        return uncertainty(task.model, task.recordings, estimate.final, u, choice.level, passes), ()
    except (NoiseidError, np.linalg.LinAlgError) as error:
        return None, (f"no standard errors: {error}",)


def _without_score(name: str, estimate: Estimate) -> tuple[str, ...]:
    """Why there are none; nothing is said where the method has standard errors of its own."""
    if estimate.parameters is not None and estimate.parameters.standard_errors is not None:
        return ()
    return (
        f"no standard errors: {name} does not maximise the likelihood, whose curvature gives them; "
        "`uncertainty: {method: bootstrap}` does without",
    )


def _of_ml(task: Task, estimate: Estimate, level: float) -> Uncertainty:
    """Standard errors of the noise values from the exact gradient, with the parameters as unknown as they were."""
    import numpy as np

    from noiseid_cli.estimators.observed_information import marginal_information
    from noiseid_cli.estimators.uncertainty import uncertainty
    from noiseid_cli.estimators.unknowns import ParameterUnknowns

    free = task.parameters
    held: tuple[str, ...] = ()
    if estimate.parameters is not None and estimate.parameters.standard_errors is not None:
        known = np.isfinite(estimate.parameters.standard_errors)
        held = tuple(np.array(free.names)[~known])
        free = ParameterUnknowns(
            tuple(np.array(free.names)[known]), estimate.parameters.final[known], free.lower[known], free.upper[known]
        )
    order = [p.name for p in task.equations.parameters]
    at = [order.index(name) for name in free.names]
    problem = (task.model, task.recordings, estimate.final, task.unknowns)

    def observed(steps: Array) -> Array:
        return marginal_information(*problem, free, at, steps)

    found = uncertainty(*problem, level, observed=observed)
    if np.any(found.shares <= NOTHING) or np.any(found.shares > TOO_MUCH):
        # Open directions are the score's to tell; teeth of a jagged log-likelihood it does not see.
        smooth = uncertainty(*problem, level)
        if np.all(smooth.shares > NOTHING):
            also = ", and hold the model's parameters at their estimates" if len(task.parameters) else ""
            jagged = (
                "The filter's own log-likelihood has no clear curvature at the scale of standard errors: it is jagged "
                f"there. These are from the smoother's score, which leaves out that the linearisation moves{also}."
            )
            return replace(smooth, remarks=(*smooth.remarks, jagged))
    if held:
        found = replace(found, remarks=(*found.remarks, f"The standard errors of the noise hold {', '.join(held)}."))
    return found

"""What stands in an estimate by EM of how it came about: the trace of its passes, its safeguards and warnings."""

from __future__ import annotations

import numpy as np

from noiseid_cli.estimators.em_run import EmRun
from noiseid_cli.estimators.estimate import plural
from noiseid_cli.models.recording import Array


def trace(run: EmRun) -> dict[str, Array]:
    """One entry a pass: log-likelihood, values, size of the EM step, whether accelerated and accepted."""
    return {
        "loglik": np.array([p.loglik for p in run.points]),
        "Q": np.array([p.noise.Q for p in run.points]),
        "R": np.array([p.noise.R for p in run.points]),
        "change": np.array([p.change for p in run.points]),
        "extrapolated": np.array([float(p.extrapolated) for p in run.points]),
        "accepted": np.array([float(p.accepted) for p in run.points]),
    }


def safeguards(run: EmRun, linearisation: str) -> list[str]:
    """Each safeguard that acted and each warning about the end, in a sentence.

    Args:
        run: the run.
        linearisation: its name, ``smoothed`` or ``filtered``.
    """
    out = []
    rejected = sum(not p.accepted for p in run.points)
    if rejected:
        out.append(f"{plural(rejected, 'accelerated step')} lowered the log-likelihood: rejected")
    if run.indefinite:
        out.append(f"{plural(run.indefinite, 'accelerated step')} led to what is no covariance: left out")
    if run.divergences:
        out.append(
            f"{plural(len(run.divergences), 'accelerated step')} made the filter fail: first, {run.divergences[0]}"
        )
    if run.falls:
        other = "linearisation: filtered" if linearisation == "smoothed" else "linearisation: smoothed"
        other = other if run.weights is None else "smoother: extended"
        steps = plural(len(run.falls), "plain EM step")
        out.append(
            f"the log-likelihood fell in {steps}, by {max(run.falls):.3g} at most: an approximate E-step gives no "
            f"guarantee; the best point was kept; `{other}` may do better"
        )
    if run.singular:
        out.append(f"{run.singular} predicted covariances were singular (a state was exactly known)")
    end = run.best.noise
    for name, structure, value in (("Q", run.unknowns.Q, end.Q), ("R", run.unknowns.R, end.R)):
        if structure is None:
            continue
        scale = np.sqrt(np.diag(structure.start))
        spread = np.linalg.eigvalsh(value / np.outer(scale, scale))
        if spread[0] < 1e-8 * spread[-1]:
            out.append(
                f"{name} is going to zero along one direction (eigenvalue ratio {spread[0] / spread[-1]:.1g}): zero is "
                "a fixed point of EM, so this can be the answer or a false end; another start tells"
            )
    return out

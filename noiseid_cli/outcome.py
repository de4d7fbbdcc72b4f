"""What one unit of work ends with: an estimate, its evaluations, and enough names to print both."""

from __future__ import annotations

from dataclasses import dataclass, field

from noiseid_cli.diagnostics.evaluation import Evaluation
from noiseid_cli.estimators.estimate import Columns, Estimate, Uncertainty
from noiseid_cli.models.recording import Array

__all__ = ["Columns", "UnitResult"]


@dataclass(frozen=True)
class UnitResult:
    """One method, from one start, on one dataset.

    Attributes:
        unit: label of the unit, such as ``replicate-000/em/start-0``.
        dataset: name of the dataset.
        method_label: label of the method in the experiment; ``estimate.method`` is its registered name.
        start_index: number of the start, from 0.
        start_label: what the start was, such as ``× 0.01`` or ``drawn 3``.
        replicate: number of the dataset's replicate, from 0.
        estimate: the end of the estimator's run.
        evaluations: filter against the data that was fitted, keyed ``tuning`` (the values in use today, if given),
            ``start``, ``estimate`` and, where known, ``truth``.
        noise_names, output_names, state_names: the model's columns.
        test_names: names of the dataset's tests.
        Q_true: (nv, nv) covariance of the process noise, where known.
        R_true: (ny, ny) covariance of the measurement noise, where known.
        seconds: wall-clock time of the unit.
        seed: seed of the experiment.
        held_out: the same filters against tests, or the ends of tests, that no method has seen, with the same keys;
            empty without such data.
        held_out_tests: number of those tests.
        density: Q is a density: its standard deviations are in the unit of the noise per root hertz.
        interval: what converts one into the other, s: Q per sample = density / interval; the median of the data's.
            None where nothing does (a discrete model, or a Q per sample on unequal intervals).
        uncertainty: standard errors and intervals; None where there are none, ``estimate.safeguards`` says why.
        Q_tuning, R_tuning: (nv, nv) and (ny, ny) covariances in use today, where given.
        parameters_true: (p,) truth of ``estimate.parameters``, NaN where not known; None where nothing is known.
    """

    unit: str
    dataset: str
    method_label: str
    start_index: int
    start_label: str
    replicate: int
    estimate: Estimate
    evaluations: dict[str, Evaluation]
    noise_names: Columns
    output_names: Columns
    state_names: Columns
    test_names: tuple[str, ...]
    Q_true: Array | None
    R_true: Array | None
    seconds: float
    seed: int
    held_out: dict[str, Evaluation] = field(default_factory=dict)
    held_out_tests: int = 0
    parameters_true: Array | None = None
    density: bool = False
    interval: float | None = None
    uncertainty: Uncertainty | None = None
    Q_tuning: Array | None = None
    R_tuning: Array | None = None

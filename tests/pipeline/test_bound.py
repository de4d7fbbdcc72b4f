"""The Cramer-Rao bound in a report of replicates: which methods have one, and that it is the library's."""

import numpy as np
import pytest
from small_experiment import noiseid, write_experiment

from noiseid_cli.estimators.expected_information import cramer_rao
from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.estimators.unknowns import Unknowns
from noiseid_cli.models.linear import linear_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording
from noiseid_cli.pipeline.context import open_experiment
from noiseid_cli.pipeline.reporting import gather

LINEAR = """\
experiment: two_noises
model:
  linear: {A: [[0.9, 0.1], [0, 0.8]], C: [[1, 0], [0, 1]]}
simulate:
  samples: 60
  replicates: 2
  trajectory: {kind: zero}
  process_noise: {full: [[1, 0.5], [0.5, 2]]}
  measurement_noise: {std: [0.5, 0.5]}
estimate:
  process_noise: {start: {std: [1, 1]}}
  measurement_noise: {start: {std: [1, 1]}, tied: [[y1, y2]], structure: diagonal}
  initial_mean: {known: truth}
  initial_covariance: {known: {std: [0, 0]}}
  uncertainty: {method: none}
  holdout: {last: 0.5}
  methods:
    em: {}
    apart: {method: em, structure: diagonal}
report: {formats: [csv]}
"""


def test_the_bound_is_that_of_the_fitted_part_and_of_the_structure(tmp_path):
    file = write_experiment(tmp_path, LINEAR)
    ran = noiseid("run", file, "--out", tmp_path / "runs", "--quiet", "--jobs", "1")
    assert ran.exit_code in (0, 4), ran.output
    found = gather(open_experiment(file, tmp_path / "runs"))[0].bounds
    # The true noises are correlated: an estimate that says they are not has no bound.
    assert list(found) == ["em"]
    noise = NoiseValues(np.array([[1, 0.5], [0.5, 2]]), 0.25 * np.eye(2), np.zeros((1, 2)), np.zeros((2, 2)))
    tied = CovarianceStructure(noise.R, ((0,), (1,)), tied=((0, 1),))
    model = linear_model([[0.9, 0.1], [0, 0.8]], np.eye(2), np.eye(2))
    half = Recording("half", np.ones(29), np.zeros((30, 0)), np.zeros((30, 2)))
    own = cramer_rao(model, [half], noise, Unknowns(Q=CovarianceStructure.full(noise.Q), R=tied))
    assert found["em"] == pytest.approx(own)

"""`model.markov_noise` from the experiment file to the result."""

import numpy as np
import pytest

from noiseid_cli.errors import ConfigError, EstimationError
from noiseid_cli.pipeline.context import open_experiment
from noiseid_cli.pipeline.datasets import make_dataset
from noiseid_cli.pipeline.estimation import make_estimate
from noiseid_cli.pipeline.units import dataset_units, estimate_units

MARKOV = (
    "model.markov_noise={on: [v], time_constant: 0.2}",
    "simulate.process_noise={std: [5]}",
    "estimate.process_noise={start: {std: [10]}}",
    "estimate.initial_covariance={known: {std: [1e-3, 1e-2, 1]}}",
)


def opened(small, *overrides):
    return open_experiment(small, small.parent, (*MARKOV, *overrides))


def test_simulated_and_estimated(small):
    context = opened(small)
    data, unit = dataset_units(context)[0], estimate_units(context)[0]
    dataset = make_dataset(context, data)
    assert dataset.states[2][:2] == ("xi_v", "N")
    assert np.std(dataset.recordings[0].x_true[:, 2]) > 0.05
    result = make_estimate(context, unit)
    assert result.noise_names == (("w_v", "N/s", "drives xi_v"),)
    assert result.estimate.final.P0.shape == (3, 3)
    assert 0.3 < np.sqrt(result.estimate.final.Q[0, 0]) / 5 < 3


def test_a_time_constant_within_an_interval_is_refused(small):
    context = opened(small, "model.markov_noise.time_constant=0.005")
    make_dataset(context, dataset_units(context)[0])
    with pytest.raises(EstimationError, match=r"time constant of v, 0\.005 s, is not above the interval of test"):
        make_estimate(context, estimate_units(context)[0])


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("{on: [w], time_constant: 1}", r"markov_noise\.on\.0: process noise w is not known"),
        ("{on: [v, v], time_constant: 1}", r"on\.1: v is in the list twice"),
        ("{on: [v], time_constant: 0}", "time_constant"),
        ("{on: [v], time_constant: {w: 1}}", r"time_constant\.w: w is not in the list"),
    ],
)
def test_mistakes_have_a_place(small, setting, words):
    with pytest.raises(ConfigError, match=words):
        open_experiment(small, small.parent, (f"model.markov_noise={setting}",))

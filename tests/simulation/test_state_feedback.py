"""State feedback: its filter is the textbook's, whatever is measured of the first sample."""

import numpy as np
import pytest
from covariance_form import filter_twin

from noiseid_cli.errors import ModelError
from noiseid_cli.models.linear import linear_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.registry import load_model
from noiseid_cli.simulation.motions import Feedback, plan_motion
from noiseid_cli.simulation.simulate import simulate

A = [[1.0, 1.0], [0.0, 0.9]]
LAW = NoiseValues(np.diag([0.1, 0.2]), np.array([[0.3]]), np.array([[1.0, -1.0]]), np.diag([2.0, 0.5]))
GAIN = ((0.2, 0.6),)


@pytest.mark.parametrize("first_output", [True, False])
def test_inputs_are_the_gain_on_the_textbook_filters_state(first_output):
    compiled = linear_model(A, np.eye(2), [[1.0, 0.0]], [[0.0], [1.0]])
    model = load_model("markov_manipulator")  # lends its names and its interval of 1 s
    plan = plan_motion("state_feedback", Feedback(GAIN), model, compiled, 30, LAW)
    dataset = simulate(
        model, compiled, plan, LAW.Q, LAW.R, seed=4, samples=30, tests=2, P0=LAW.P0, first_output=first_output
    )
    for recording in dataset.recordings:
        assert np.isnan(recording.y[0, 0]) != first_output
        expected = -np.array(filter_twin(compiled, recording, LAW).m_filt) @ np.array(GAIN).T
        np.testing.assert_allclose(recording.u, expected, rtol=1e-10, atol=1e-12)


def test_a_gain_of_another_size_is_refused():
    compiled = linear_model(A, np.eye(2), [[1.0, 0.0]], [[0.0], [1.0]])
    with pytest.raises(ModelError, match=r"gain must have 1 rows \(inputs\) of 2 numbers"):
        plan_motion("state_feedback", Feedback(((1.0,),)), load_model("markov_manipulator"), compiled, 5, LAW)
    with pytest.raises(ModelError, match="the law of the noise is needed"):
        plan_motion("state_feedback", Feedback(GAIN), load_model("markov_manipulator"), compiled, 5)

"""Parameters that change during a test, and the truth that the dataset carries."""

import numpy as np
import pytest

from noiseid_cli.errors import ModelError
from noiseid_cli.models.compile import compile_model
from noiseid_cli.models.registry import load_model
from noiseid_cli.simulation.motions import Zero, plan_motion
from noiseid_cli.simulation.parameter_changes import ParameterChange, first_sample, parameters_over_time
from noiseid_cli.simulation.simulate import simulate

NOTHING = np.zeros((2, 2))


def falling(changes, samples=60, x0=(1.0, 2.0)):
    model = load_model("one_link", {"Ts": 0.01})
    compiled = compile_model(model)
    plan = plan_motion("zero", Zero(), model, compiled, samples)
    data = simulate(model, compiled, plan, NOTHING, NOTHING, seed=1, samples=samples, x0=np.array(x0), changes=changes)
    return model, data


def test_the_first_sample_of_a_change():
    assert [first_sample(t, 2e-4) for t in (0.0, 2e-4, 11.0, 11.00001, 3 * 2e-4)] == [0, 1, 55_000, 55_001, 3]


def test_changes_act_in_order_of_time_and_stay():
    model = load_model("one_link", {"Ts": 0.1})
    changes = [
        ParameterChange(0.5, scale={"mu_v": 2.0}),
        ParameterChange(0.3, set={"mu_v": 1.0, "k": 7.0}),
        ParameterChange(0.5, scale={"mu_v": 5.0}),
    ]
    values = parameters_over_time(model, changes, 8)
    names = list(model.values)
    np.testing.assert_array_equal(values[:, names.index("mu_v")], [0.05] * 3 + [1.0] * 2 + [10.0] * 3)
    np.testing.assert_array_equal(values[:, names.index("k")], [10.0] * 3 + [7.0] * 5)
    others = [i for i, name in enumerate(names) if name not in ("mu_v", "k")]
    np.testing.assert_array_equal(values[:, others], np.tile(model.vector[others], (8, 1)))


def test_a_changed_test_is_two_tests_in_succession():
    """From the change on, the motion is that of a model with the new values that starts there."""
    change = ParameterChange(0.2, set={"mal2": 0.3}, scale={"mu_v": 4.0})
    model, data = falling([change])
    (test,) = data.recordings
    _, before = falling([], 20)
    np.testing.assert_array_equal(test.x_true[:20], before.recordings[0].x_true)
    other = load_model("one_link", {"Ts": 0.01, "mal2": 0.3, "mu_v": 0.2})
    compiled = compile_model(other)
    plan = plan_motion("zero", Zero(), other, compiled, 40)
    after = simulate(other, compiled, plan, NOTHING, NOTHING, seed=1, samples=40, x0=test.x_true[20])
    np.testing.assert_array_equal(test.x_true[20:], after.recordings[0].x_true)
    np.testing.assert_array_equal(test.y[20:], after.recordings[0].y)
    assert test.y[20, 1] != falling([])[1].recordings[0].y[20, 1]
    assert [c[0] for c in data.parameters] == list(model.values)
    assert data.parameters[1][1:] == ("N m s/rad", "viscous friction")
    np.testing.assert_array_equal(test.parameters_true[[0, 19]], [model.vector] * 2)
    np.testing.assert_array_equal(test.parameters_true[[20, 59]], [other.vector] * 2)


def test_without_changes_no_truth_over_time_is_kept():
    _, data = falling([], 5)
    assert data.parameters == ()
    assert data.recordings[0].parameters_true is None


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (ParameterChange(0.1, set={"mu": 1.0}), "one_link: parameter mu is not known; did you mean mu_"),
        (ParameterChange(0.1, scale={"Ts": 2.0}), "parameter Ts equals the sample time, which cannot change"),
    ],
)
def test_changes_that_cannot_be(change, said):
    with pytest.raises(ModelError, match=said):
        falling([change], 5)

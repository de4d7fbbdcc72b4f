"""A joint that moves to and fro: reference, hold, controller, closed loop."""

import math
from dataclasses import replace

import numpy as np
import pytest

from noiseid_cli.errors import DataError, ModelError
from noiseid_cli.models.compile import compile_model
from noiseid_cli.models.registry import load_model
from noiseid_cli.simulation.motions import SCurveMotion, plan_motion
from noiseid_cli.simulation.s_curve import Cascade, SCurve, rests
from noiseid_cli.simulation.simulate import simulate

HALF = math.pi / 2
PAPER = SCurve(between=(-HALF, HALF), start=0.0, move_time=2.0, dwell=0.2, hold=(11.0, 15.5))
MOTION = SCurveMotion(
    input="tau", output="q", between=(-HALF, HALF), start=0.0, move_time=2.0, dwell=0.2, hold=(11.0, 15.5),
    position_gain=15.0, speed_gain=1.5, cutoff=60.0,
)  # fmt: skip


@pytest.fixture(scope="module")
def one_link():
    model = load_model("one_link", {"Ts": 1e-3})
    return model, compile_model(model)


def test_reference_rests_at_its_ends_and_is_held():
    times = np.array([0, 2.0, 2.1, 4.2, 4.4, 6.4, 8.6, 10.8, 11.0, 13.0, 15.5, 17.5, 17.6, 19.7])
    r, rate = PAPER.at(times)
    expected = HALF * np.array([0, 1, 1, -1, -1, 1, -1, 1, 1, 1, 1, -1, -1, 1])
    np.testing.assert_allclose(r, expected, atol=1e-12)
    np.testing.assert_allclose(rate, 0, atol=1e-12)
    middle = PAPER.at(np.array([1.0, 3.2, 16.5]))
    np.testing.assert_allclose(middle[0], [HALF / 2, 0, 0], atol=1e-12)
    # The law's slope at half time is 140/64; a whole move is pi long, the first one half of that.
    np.testing.assert_allclose(middle[1], np.array([HALF, -math.pi, -math.pi]) * 140 / 64 / 2, rtol=1e-12)


@pytest.mark.parametrize("curve", [PAPER, SCurve((1.0, 3.0), 1.0, 0.5, 0.0)])
def test_rate_is_the_slope_and_nothing_jumps(curve):
    h = 1e-4
    time = h * np.arange(1, 180_000 if curve is PAPER else 20_000)
    r, rate = curve.at(time)
    way = np.ptp(curve.between)
    # Central differences err by h^2 / 6 of the third derivative, at most 52.6 way / move^3.
    np.testing.assert_allclose((r[2:] - r[:-2]) / (2 * h), rate[1:-1], atol=9 * h**2 * way / curve.move_time**3 + 1e-11)
    assert r.min() >= curve.between[0] - 1e-12
    assert r.max() <= curve.between[1] + 1e-12


def test_where_it_rests():
    assert [rests(t, 2.0, 0.2) for t in (10.8, 10.9, 11.0, 10.79, 11.01, 1.0)] == [True] * 3 + [False] * 3
    assert rests(1.5, 0.5, 0.0)
    assert not rests(1.6, 0.5, 0.0)


def test_controller_is_the_cascade():
    rng = np.random.default_rng(1)
    r, rate, y = rng.normal(size=(3, 30))
    dt = 1e-3
    controller = Cascade((r, rate), dt, gains=(15.0, 1.5), cutoff=60.0, acts_on=1, reads=2, inputs=3)
    assert controller.reads == (2,)
    keep = math.exp(-2 * math.pi * 60 * dt)
    for _ in range(2):  # started anew, it has forgotten the last test
        controller.start()
        speed = 0.0
        for k in range(30):
            if k:
                speed = keep * speed + (1 - keep) * (y[k] - y[k - 1]) / dt
            u = controller.control(k, np.array([np.nan, np.nan, y[k]]))
            np.testing.assert_allclose(u, [0, 1.5 * (15 * (r[k] - y[k]) + rate[k] - speed), 0], rtol=1e-12)


def test_one_link_follows_the_reference(one_link):
    """Without noise the lag is the controller's: gravity, friction and inertia over Kv Kp = 22.5 N m/rad."""
    model, compiled = one_link
    plan = plan_motion("s_curve", MOTION, model, compiled, 12_000)
    np.testing.assert_array_equal(plan.x0, [0, 0])
    nothing = np.zeros((2, 2))
    (test,) = simulate(model, compiled, plan, nothing, nothing, seed=1, samples=12_000).recordings
    r, _ = PAPER.at(test.time)
    p = model.values
    torque = p["mal2"] * p["g"] / 2 + p["mu_d"] * HALF + p["mu_v"] * 4 + 8 / p["inverse_inertia"]
    assert np.abs(test.x_true[:, 0] - r).max() < torque / 22.5
    assert np.ptp(test.x_true[:, 0]) > 0.97 * math.pi


def test_a_pendubot_hangs_from_the_first_state_given():
    model = load_model("pendubot", {"Ts": 1e-3})
    compiled = compile_model(model)
    motion = replace(MOTION, output="q1", between=(-HALF, 0.0), start=None, move_time=1.5, hold=None, speed_gain=4.0)
    plan = plan_motion("s_curve", motion, model, compiled, 1600)
    hanging = np.array([-HALF, 0, 0, 0])
    nothing = np.zeros((4, 4)), np.zeros((3, 3))
    (test,) = simulate(model, compiled, plan, *nothing, seed=1, samples=1600, x0=hanging).recordings
    np.testing.assert_array_equal(test.x_true[0], hanging)
    # At the end link 1 lags by what holds both links level, over Kv Kp = 60 N m/rad.
    held = 9.81 * (0.717 + 0.146) + 0.226 * HALF
    assert abs(test.x_true[-1, 0]) < held / 60 + 0.05


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"input": "tua"}, "tua is not an input of one_link; it has tau"),
        ({"output": "p"}, "p is not an output of one_link; it has q, ddq"),
        ({"hold": (10.0, 15.0)}, "hold must begin while the reference rests"),
        ({"hold": (11.0, 10.9)}, "hold must begin while the reference rests, and end later"),
        ({"cutoff": 0.0}, "cutoff must be above 0"),
        ({"dwell": -0.1}, "dwell at least 0"),
    ],
)
def test_motions_that_cannot_be(one_link, change, said):
    with pytest.raises(ModelError, match=said):
        plan_motion("s_curve", replace(MOTION, **change), *one_link, 10)


def test_an_output_with_feedthrough_cannot_be_controlled(one_link):
    model, compiled = one_link
    plan = plan_motion("s_curve", replace(MOTION, output="ddq"), model, compiled, 10)
    with pytest.raises(DataError, match="the controller reads ddq, which depends on the input that it sets"):
        simulate(model, compiled, plan, np.zeros((2, 2)), np.zeros((2, 2)), seed=1, samples=10)

"""Quantisation, rest, and repeated or derived channels, found in the data alone."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from noiseid_cli.diagnostics.data_properties import (
    data_warnings,
    output_steps,
    quantisation_step,
    rounding_warnings,
    size_warnings,
)
from noiseid_cli.models.recording import Dataset, Recording

MEASURED = Path(__file__).parents[2] / "data" / "measured"


def dataset(*columns, dt=None, units="rad"):
    y = np.column_stack(columns)
    dt = np.full(len(y) - 1, 0.01) if dt is None else dt
    names = tuple((f"y{i + 1}", units, "") for i in range(y.shape[1]))
    return Dataset("d", "m", (Recording("a", dt, np.empty((len(y), 0)), y),), outputs=names)


@pytest.mark.parametrize("step", [1.0, 2 * math.pi / 4096, 3e-7])
@pytest.mark.parametrize("offset", [0.0, 0.3])
def test_a_step_is_found_through_the_decimals_of_a_file(step, offset):
    """Nine significant digits, as in a log; large jumps beside small ones."""
    rng = np.random.default_rng(1)
    levels = np.cumsum(rng.integers(-3, 4, size=3000) + (rng.uniform(size=3000) < 0.01) * 500)
    values = offset * step + step * levels
    written = np.array([float(f"{v:.9g}") for v in values])
    assert quantisation_step(written) == pytest.approx(step, rel=1e-5)


def test_no_step_where_there_is_none():
    rng = np.random.default_rng(2)
    assert quantisation_step(rng.normal(size=2000)) is None
    assert quantisation_step(np.full(50, 3.0)) is None
    assert quantisation_step(np.full(50, np.nan)) is None
    # Three odd values tell nothing, unless they are met again and again.
    assert quantisation_step(np.array([0.0, 0.1, 0.2])) is None
    assert quantisation_step(np.tile([0.0, 0.1, 0.3], 10)) == pytest.approx(0.1)


def test_missing_values_and_several_tests_are_one_channel():
    a, b = np.round(np.linspace(0, 3, 40)), np.round(np.linspace(5, 9, 40)) + 0.0
    a[3] = np.nan
    d = dataset(a)
    two = Dataset("d", "m", (*d.recordings, *dataset(b).recordings), outputs=d.outputs)
    assert output_steps(two) == (1.0,)


def test_measured_logs():
    """The encoder's step in both; the speeds of the swing-up are differences, those of the excitation are not."""
    found = {}
    for name in ("double_pendulum_excited", "pendubot_swing_up"):
        log = np.genfromtxt(MEASURED / f"{name}.csv", delimiter=",", names=True)
        columns = [log[c] for c in ("pos_meas1", "pos_meas2", "vel_meas1", "vel_meas2")]
        found[name] = dataset(*columns, dt=np.diff(log["time"]))
        assert output_steps(found[name])[:2] == pytest.approx((3.81475548e-4,) * 2, rel=1e-6)
    swing_up = " ".join(data_warnings(found["pendubot_swing_up"]))
    assert "y3 is the backward difference of y1" in swing_up
    assert "y4 is the backward difference of y2" in swing_up
    assert "y3 is the backward difference of y2" not in swing_up
    assert "difference" not in " ".join(data_warnings(found["double_pendulum_excited"]))


def test_noise_below_rounding_is_said():
    rng = np.random.default_rng(3)
    d = dataset(np.round(50 * rng.normal(size=400)) * 0.2, rng.normal(size=400))
    limit = 0.2**2 / 12
    assert rounding_warnings(d, np.diag([limit * 1.01, 1e-20])) == []
    (said,) = rounding_warnings(d, np.diag([limit / 9, 1e-20]))
    assert "of y1" in said
    assert "0.096 quantisation steps" in said
    assert "0.29 steps of 0.2 rad" in said


def test_noise_beyond_what_drives_the_system_is_said():
    """Root mean squares of 3 and 4 N m: a noise of 5 N m is 1.25 times the greater; one of 3.9 is not."""
    d = dataset(np.zeros(4))
    u = np.array([[3.0, 4.0, 9.0], [-3.0, 4.0, 9.0], [3.0, -4.0, 9.0], [-3.0, 4.0, 9.0]])
    names = (("a", "N m", ""), ("b", "N m", ""), ("other", "m", ""))
    d = replace(d, recordings=(replace(d.recordings[0], u=u),), inputs=names)
    noises = (("v", "N m", ""), ("w", "N m", ""), ("x", "V", ""))
    (said,) = size_warnings(d, noises, np.diag([25.0, 3.9**2, 1e6]))
    assert "process noise v, 5 N m per sample, is 1.2 times" in said
    assert "of the input b, 4 N m" in said
    still = replace(d, recordings=(replace(d.recordings[0], u=0.0 * u),))
    assert size_warnings(still, noises, np.eye(3)) == []


def test_almost_at_rest_is_said():
    level = np.repeat([0.0, 0.1, 0.0, 0.1, 0.2], 40)
    said = " ".join(data_warnings(dataset(level)))
    assert "y1 moves in steps of 0.1 rad" in said
    assert "y1 keeps its value over 98 % of the samples" in said
    moving = np.round(np.cumsum(np.random.default_rng(0).normal(size=300)), 1)
    assert "keeps its value" not in " ".join(data_warnings(dataset(moving)))


def test_identical_outputs_are_said_once_and_constant_ones_are_not():
    a = np.random.default_rng(5).normal(size=30)
    said = [s for s in data_warnings(dataset(a, a.copy(), np.zeros(30), np.zeros(30))) if "same numbers" in s]
    assert said == ["y1 and y2 are the same numbers: one measurement counted twice; leave one out"]
    assert not [s for s in data_warnings(dataset(a, a + 1e-9)) if "same numbers" in s]

"""A longer sample time of the same recording: what is kept, and what the process noise makes of it."""

from dataclasses import replace

import numpy as np
import pytest

from noiseid_cli.errors import DataError
from noiseid_cli.estimators import em
from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.estimators.unknowns import Unknowns
from noiseid_cli.models.linear import linear_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording
from noiseid_cli.models.schemes import DENSITY, EULER
from noiseid_cli.recordings.decimation import decimate
from noiseid_cli.recordings.faults import Findings
from noiseid_cli.recordings.options import Decimation

UNEQUAL = Recording(
    "log",
    dt=np.array([1.0, 2.0, 1.0, 1.0, 3.0, 1.0]),
    u=np.array([[3.0], [6.0], [0.0], [2.0], [4.0], [8.0], [9.0]]),
    y=np.array([[0.0], [np.nan], [2.0], [3.0], [4.0], [5.0], [6.0]]),
    start=10.0,
)


def test_picked_outputs_and_inputs_averaged_by_time():
    findings = Findings()
    out = decimate(UNEQUAL, Decimation(3), findings)
    np.testing.assert_allclose(out.time, [10.0, 14.0, 19.0])
    np.testing.assert_array_equal(out.y[:, 0], [0.0, 3.0, 6.0])
    # (3 * 1 + 6 * 2 + 0 * 1) / 4 and (2 * 1 + 4 * 3 + 8 * 1) / 5; at the end, the input in force.
    np.testing.assert_allclose(out.u[:, 0], [15 / 4, 22 / 5, 9.0])
    assert findings.notes == [
        "log: 3 samples kept of 7, one in 3; outputs picked, inputs averaged over the longer intervals"
    ]


def test_averaged_outputs_stand_at_the_mean_time_of_their_block():
    findings = Findings()
    out = decimate(UNEQUAL, Decimation(2, "average"), findings)
    np.testing.assert_allclose(out.time, [10.5, 13.5, 16.5])
    np.testing.assert_array_equal(out.y[:, 0], [0.0, 2.5, 4.5])
    # From 10.5 to 13.5: 3 for 0.5 s, 6 for 2 s, 0 for 0.5 s. From 13.5: 0 for 0.5 s, 2 for 1 s, 4 for 1.5 s.
    np.testing.assert_allclose(out.u[:, 0], [13.5 / 3, 8 / 3, 4.0])
    assert "averaged over 2 samples" in findings.notes[0]


def test_a_block_without_a_value_is_missing_and_no_input_is_no_trouble():
    empty = replace(UNEQUAL, u=np.zeros((7, 0)), y=np.full((7, 1), np.nan))
    out = decimate(empty, Decimation(2, "average"), Findings())
    assert out.u.shape == (3, 0)
    assert np.isnan(out.y).all()


def test_numbers_too_large_to_be_averaged_are_refused():
    large = replace(UNEQUAL, u=np.full((7, 1), 1e308))
    with pytest.raises(DataError, match="too large to be averaged"):
        decimate(large, Decimation(3), Findings())
    large = replace(UNEQUAL, y=np.full((7, 1), 1e308))
    with pytest.raises(DataError, match="too large to be averaged"):
        decimate(large, Decimation(3, "average"), Findings())
    assert np.all(decimate(large, Decimation(3), Findings()).y == 1e308)


def test_a_linear_system_under_held_inputs_is_at_the_same_place():
    """An integrator: the average does over the longer interval what the inputs did one by one."""
    rng = np.random.default_rng(1)
    dt, u = rng.uniform(0.5, 2, size=20), rng.normal(size=(21, 1))
    x = np.concatenate(([0.0], np.cumsum(dt * u[:-1, 0])))
    out = decimate(Recording("r", dt, u, x[:, None]), Decimation(5), Findings())
    np.testing.assert_allclose(np.cumsum(out.dt * out.u[:-1, 0]), out.y[1:, 0], atol=1e-12)


def wiener(seed, samples, dt, density, noise):
    rng = np.random.default_rng(seed)
    x = np.cumsum(np.sqrt(density * dt) * rng.normal(size=samples))
    return Recording(
        "w", np.full(samples - 1, dt), np.zeros((samples, 0)), (x + noise * rng.normal(size=samples))[:, None]
    )


@pytest.mark.parametrize("factor", [2, 5])
def test_the_density_stays_and_the_covariance_per_sample_does_not(factor):
    """Where the steps exceed the noise, both estimates err by about sqrt(2 / n) of themselves, n the samples left."""
    dt, S, noise = 0.01, 4.0, 0.02
    fine = wiener(7, 6001, dt, S, noise)
    coarse = decimate(fine, Decimation(factor), Findings())
    base = linear_model(A=[[0.0]], G=[[1.0]], C=[[1.0]])
    start = NoiseValues(np.array([[1.0]]), np.array([[noise**2]]), np.zeros((1, 1)), np.array([[1.0]]))
    unknowns = Unknowns(Q=CovarianceStructure.full(start.Q))

    def found(recording, scheme):
        model = replace(base, scheme=scheme)
        return em.estimate(model, [recording], start, unknowns).final.Q[0, 0]

    bound = 4 * np.sqrt(2 / coarse.samples)
    densities = [found(r, EULER + DENSITY) for r in (fine, coarse)]
    assert densities[0] == pytest.approx(S, rel=bound)
    assert densities[1] == pytest.approx(densities[0], rel=bound)
    assert found(fine, EULER) == pytest.approx(densities[0] / dt, rel=1e-3)
    assert found(coarse, EULER) == pytest.approx(densities[1] / (factor * dt), rel=1e-3)

"""From the `estimate` section to start values and unknowns: every structure and every form of start."""

import numpy as np
import pytest

from noiseid_cli.config.schema_estimate import Estimate
from noiseid_cli.errors import EstimationError
from noiseid_cli.models.recording import Dataset, Recording
from noiseid_cli.models.systems.markov_manipulator import MarkovManipulator
from noiseid_cli.models.systems.one_link import OneLink
from noiseid_cli.pipeline.problem import check_sample_time, pose, pose_parameters


class Sizes:
    """The names that `pose` asks a compiled model for."""

    states, noises, outputs = ("p", "w"), ("a", "b", "c"), ("y1", "y2")
    ny = 2


def section(**changes):
    given = {
        "process_noise": {"start": {"std": [1.0, 2.0, 3.0]}},
        "measurement_noise": {"known": {"diag": [4.0, 9.0]}},
        "initial_mean": {"known": [0.5, -0.5]},
        "initial_covariance": {"known": {"full": [[2.0, 0.5], [0.5, 1.0]]}},
    }
    return Estimate.model_validate(given | changes)


def dataset(*names, truth=True):
    def test(k, name):
        states = np.array([[10.0 + k, 20.0 + k], [0.0, 0.0]])
        return Recording(name, np.ones(1), np.zeros((2, 0)), np.zeros((2, 2)), x_true=states if truth else None)

    return Dataset("data", "sizes", tuple(test(k, name) for k, name in enumerate(names)), (), ())


ONE = dataset("one")


def test_known_values_are_taken_as_they_are():
    noise, unknowns = pose(section(), ONE, Sizes, factors=(100.0, 100.0, 100.0), measurement_factor=7.0)
    np.testing.assert_array_equal(noise.R, np.diag([4.0, 9.0]))
    np.testing.assert_array_equal(noise.P0, [[2.0, 0.5], [0.5, 1.0]])
    np.testing.assert_array_equal(noise.m0, [[0.5, -0.5]])
    assert (unknowns.R, unknowns.P0, unknowns.m0) == (None, None, False)


@pytest.mark.parametrize(
    ("form", "matrix"),
    [
        ({"std": [1, 2, 3]}, np.diag([1.0, 4.0, 9.0])),
        ({"diag": [1, 2, 3]}, np.diag([1.0, 2.0, 3.0])),
        (
            {"std": [1, 2, 3], "correlation": [[1, 0.5, 0], [0.5, 1, 0.25], [0, 0.25, 1]]},
            [[1, 1, 0], [1, 4, 1.5], [0, 1.5, 9]],
        ),
        ({"full": [[1, 0.5, 0], [0.5, 2, 0], [0, 0, 3]]}, [[1, 0.5, 0], [0.5, 2, 0], [0, 0, 3]]),
    ],
)
def test_each_form_of_start_and_its_factors(form, matrix):
    noise, unknowns = pose(section(process_noise={"start": form}), ONE, Sizes)
    np.testing.assert_array_equal(noise.Q, matrix)
    np.testing.assert_array_equal(unknowns.Q.start, noise.Q)
    factors = (4.0, 1.0, 0.25)
    scaled, _ = pose(section(process_noise={"start": form}), ONE, Sizes, factors)
    # Variances by their factors, correlations as they were.
    np.testing.assert_allclose(np.diag(scaled.Q), np.diag(matrix) * factors, rtol=1e-15)
    deviations, before = np.sqrt(np.diag(scaled.Q)), np.sqrt(np.diag(noise.Q))
    np.testing.assert_allclose(
        scaled.Q / np.outer(deviations, deviations), noise.Q / np.outer(before, before), rtol=1e-14
    )


@pytest.mark.parametrize("factor", [1e-300, 1e300])
def test_extreme_factors_neither_overflow_nor_vanish(factor):
    noise, _ = pose(section(), ONE, Sizes, (factor,) * 3)
    np.testing.assert_allclose(np.diag(noise.Q), np.array([1.0, 4.0, 9.0]) * factor, rtol=1e-14)


def structure_of(structure, **more):
    start = {"start": {"full": [[1, 0, 0], [0, 4, 0], [0, 0, 9]]}, "structure": structure}
    return pose(section(process_noise=start | more), ONE, Sizes, (4.0,) * 3)


def test_structures_free_the_entries_that_they_name():
    _, full = structure_of("full")
    assert full.Q.blocks == ((0, 1, 2),)
    assert len(full.Q.free) == 6
    _, diagonal = structure_of("diagonal")
    assert diagonal.Q.free == ((0, 0), (1, 1), (2, 2))
    _, blocks = structure_of({"blocks": [["c", "a"]]})
    assert blocks.Q.blocks == ((0, 2), (1,))
    assert set(blocks.Q.free) == {(0, 0), (2, 0), (2, 2), (1, 1)}
    noise, scale = structure_of("scale")
    assert scale.Q.scale
    np.testing.assert_array_equal(scale.Q.start, noise.Q)
    np.testing.assert_array_equal(noise.Q, np.diag([4.0, 16.0, 36.0]))
    assert [unknowns.Q.what for unknowns in (full, diagonal, blocks, scale)] == ["process_noise"] * 4


def test_fixed_entries_keep_the_value_of_the_config():
    noise, unknowns = structure_of("full", fixed=["b", ["c", "a"]])
    assert unknowns.Q.held == {(1, 1), (2, 0)}
    np.testing.assert_array_equal(noise.Q, np.diag([4.0, 4.0, 36.0]))
    assert (1, 1) not in unknowns.Q.free
    assert (2, 0) not in unknowns.Q.free


def test_measurement_noise_and_first_state_can_be_unknown():
    choices = {
        "measurement_noise": {"start": {"diag": [1, 2]}, "structure": "diagonal"},
        "initial_covariance": {"start": {"std": [1, 3]}, "structure": "scale"},
        "initial_mean": {"start": [1.0, 2.0]},
    }
    noise, unknowns = pose(section(**choices), dataset("one", "two"), Sizes, (1.0,) * 3, 10.0)
    np.testing.assert_allclose(noise.R, np.diag([10.0, 20.0]), rtol=1e-15)
    assert unknowns.R.free == ((0, 0), (1, 1))
    np.testing.assert_array_equal(noise.P0, np.diag([1.0, 9.0]))  # the starts' factors are not for it
    assert unknowns.P0.scale
    assert unknowns.m0
    np.testing.assert_array_equal(noise.m0, [[1.0, 2.0], [1.0, 2.0]])


def test_forms_of_the_initial_mean():
    two = dataset("one", "two")
    known, _ = pose(section(initial_mean={"known": "truth"}), two, Sizes)
    np.testing.assert_array_equal(known.m0, [[10.0, 20.0], [11.0, 21.0]])
    named = section(initial_mean={"known": {"two": [1.0, 2.0], "one": [3.0, 4.0]}})
    np.testing.assert_array_equal(pose(named, two, Sizes)[0].m0, [[3.0, 4.0], [1.0, 2.0]])
    with pytest.raises(EstimationError, match="names no state for test 'three' of dataset data; named: two, one"):
        pose(named, dataset("one", "three"), Sizes)
    with pytest.raises(EstimationError, match="dataset data has no true states: give"):
        pose(section(initial_mean={"known": "truth"}), dataset("one", truth=False), Sizes)


def test_parameters_to_be_estimated_keep_their_order_and_bounds():
    choices = {"b": {"start": 2.0, "lower": 0.0}, "a": {"start": -1.0, "upper": 3.0}}
    found = pose_parameters(section(parameters=choices))
    assert found.names == ("b", "a")
    np.testing.assert_array_equal([found.start, found.lower, found.upper], [[2, -1], [0, -np.inf], [np.inf, 3]])
    assert len(pose_parameters(section())) == 0


@pytest.mark.parametrize("bounds", [{"lower": 1.0}, {"upper": 1.0}, {"lower": 2.0, "upper": 3.0}])
def test_a_parameter_starts_within_its_bounds(bounds):
    with pytest.raises(ValueError, match=r"must be (above lower|below upper)"):
        section(parameters={"a": {"start": 1.0, **bounds}})


def sampled(*intervals):
    tests = (Recording(f"t{dt}", np.full(3, dt), np.zeros((4, 1)), np.zeros((4, 2))) for dt in intervals)
    return Dataset("data", "one_link", tuple(tests), (), ())


def test_data_at_another_interval_than_the_models_sample_time_are_refused():
    check_sample_time(OneLink(), sampled(2e-4, 2.01e-4))
    check_sample_time(OneLink(Ts=0.001), sampled(0.001))
    check_sample_time(MarkovManipulator(), sampled(0.3))  # no parameter of it equals the sample time
    words = (
        r"test 't0\.001' are 0\.001 s apart, but Ts, .* of one_link, is 0\.0002 s: set model\.parameters\.Ts to 0\.001$"
    )
    with pytest.raises(EstimationError, match=words):
        check_sample_time(OneLink(), sampled(2e-4, 0.001))
    with pytest.raises(EstimationError, match=r"Ts to 0\.000203"):
        check_sample_time(OneLink(), sampled(2.03e-4))

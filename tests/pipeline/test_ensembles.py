"""Ensembles of tests through the experiment file: posed right, continued to the bit, refused in words."""

import re
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from noiseid_cli.errors import ConfigError, EstimationError
from noiseid_cli.estimators.cross_sectional.method import batch
from noiseid_cli.pipeline.context import open_experiment
from noiseid_cli.pipeline.datasets import make_dataset
from noiseid_cli.pipeline.ensembles import FirstStateLaw, ensemble
from noiseid_cli.pipeline.estimation import make_estimate
from noiseid_cli.pipeline.methods import Task
from noiseid_cli.pipeline.problem import pose, pose_parameters
from noiseid_cli.pipeline.units import dataset_units, estimate_units
from noiseid_cli.storage.dataset_file import read_dataset

STUDY = Path(__file__).parents[2] / "configs" / "porter1983.yaml"
SMALL = ("simulate.tests=12", "simulate.samples=40", "estimate.methods.batch-ml.at_tests=[6]")
HELD = ("model.discretisation=exact", "estimate.process_noise.known.unit=density")


def opened(root, *overrides, file=STUDY, small=SMALL):
    return open_experiment(file, root, (*small, *overrides))


def made(context):
    """The dataset of an experiment, made and read back."""
    unit = dataset_units(context)[0]
    if not unit.done:
        make_dataset(context, unit)
    return read_dataset(unit.path)


def estimated(context, method):
    made(context)
    return make_estimate(context, estimate_units(context, [method])[0])


def task(context, dataset, **changes):
    section = context.experiment.estimate
    start, unknowns = pose(section, dataset, context.compiled, first=("x1", "x2"))
    whole = Task(
        context.compiled, context.model, dataset.recordings, start, unknowns, pose_parameters(section), {}, None,
        FirstStateLaw.of(section),
    )  # fmt: skip
    return replace(whole, **changes)


def test_the_state_in_a_result_file_goes_on_to_the_last_bit(tmp_path):
    whole = estimated(opened(tmp_path), "recursive-ml").estimate
    half = opened(tmp_path, "estimate.tests.last=8")
    estimated(half, "recursive-ml")
    path = estimate_units(half, ["recursive-ml"])[0].path
    rest = opened(tmp_path, "estimate.tests.first=9", f"estimate.continue_from={path}")
    later = estimated(rest, "recursive-ml").estimate
    assert whole.state.keys() == later.state.keys()
    for name, array in whole.state.items():
        assert array.tobytes() == later.state[name].tobytes(), name
    np.testing.assert_array_equal(later.parameters.final, whole.parameters.final)
    np.testing.assert_array_equal(later.series[0].values, whole.series[0].values)


def test_other_options_than_those_of_the_state_are_refused(tmp_path):
    context = opened(tmp_path)
    estimated(context, "recursive-ml")
    path = estimate_units(context, ["recursive-ml"])[0].path
    with pytest.raises(EstimationError, match=r"made with .*'statistics'.*cannot go on with .*'literal'"):
        estimated(opened(tmp_path, f"estimate.continue_from={path}"), "recursive-literal")


def test_the_key_of_a_continuation_knows_the_content_of_what_it_goes_on_from(tmp_path):
    names = []
    for content in (b"one", b"two", b"one"):
        (tmp_path / "state.h5").write_bytes(content)
        context = opened(tmp_path, f"estimate.continue_from={tmp_path / 'state.h5'}")
        names.append(estimate_units(context, ["recursive-ml"])[0].path.name)
    assert names[0] == names[2] != names[1]


def test_batch_estimates_at_fewer_tests_are_those_of_a_shorter_ensemble(tmp_path):
    whole = estimated(opened(tmp_path), "batch-ml").estimate
    short = estimated(opened(tmp_path, "estimate.tests.last=6", "estimate.methods.batch-ml.at_tests=[]"), "batch-ml")
    curve = next(s for s in whole.series if s.name == "over_tests")
    np.testing.assert_array_equal(curve.at, [6, 12])
    np.testing.assert_allclose(curve.values[0], short.estimate.parameters.final, rtol=1e-12)
    np.testing.assert_array_equal(curve.values[1], whole.parameters.final)


def test_sampled_moments_are_those_of_the_true_first_states(tmp_path):
    context = opened(tmp_path)
    dataset = made(context)
    sampled = next(s for s in estimated(context, "batch-ml").estimate.series if s.name == "sampled_truth")
    b = np.array([r.x_true[0, :2] for r in dataset.recordings])
    np.testing.assert_allclose(sampled.values[-1], [*b.mean(axis=0), *b.var(axis=0, ddof=1)], rtol=1e-12)
    assert [name for name, _, _ in sampled.columns][2] == "initial variance x1"


def test_the_truth_and_the_filters_of_an_ensemble(tmp_path):
    result = estimated(opened(tmp_path), "batch-ml")
    np.testing.assert_allclose(result.parameters_true, [1, 0.5, 1, 0.25, 0.02, 0.05])
    # The filter at the estimate has the log-likelihood that the method reports, up to rounding.
    assert result.evaluations["estimate"].loglik == pytest.approx(result.estimate.loglik, abs=1e-6)
    assert result.evaluations["start"].loglik == pytest.approx(result.estimate.loglik_start, abs=1e-6)
    assert result.evaluations["truth"].loglik < result.estimate.loglik


def test_linearising_a_linear_model_changes_nothing(tmp_path):
    """Whatever path a linear model is taken along, its matrices are the same: so is the estimate."""
    context = opened(
        tmp_path, *HELD, "estimate.initial_covariance.structure=full", "estimate.parameters={}",
        "estimate.process_noise={start: {diag: [2], unit: density}, structure: diagonal}",
    )  # fmt: skip
    dataset = made(opened(tmp_path))
    posed = ensemble(task(context, dataset))
    # x3 has no law of its own along a path: taken as known, as it is in the linear form without one.
    bare = replace(posed, family=replace(posed.family, model=without_law(context.model)))
    linear, extended = batch(bare), batch(replace(bare, compiled=context.compiled))
    np.testing.assert_allclose(extended.parameters.final, linear.parameters.final, rtol=1e-6)
    np.testing.assert_allclose(extended.parameters.standard_errors, linear.parameters.standard_errors, rtol=1e-5)
    assert extended.loglik == pytest.approx(linear.loglik, abs=1e-6)


def without_law(model):
    model.initial_covariance = lambda p: None
    return model


def test_a_map_by_test_is_the_common_map_if_all_are_equal(tmp_path):
    matrix = "[[1, 0], [0, 1], [0, 0]]"
    by_test = ", ".join(f"test {k + 1}: {matrix}" for k in range(12))
    ends = [
        estimated(opened(tmp_path, f"estimate.initial_map={{names: [a, b], {how}}}"), "batch-ml").estimate
        for how in (f"matrix: {matrix}", f"tests: {{{by_test}}}")
    ]
    plain = estimated(opened(tmp_path), "batch-ml").estimate
    for end in ends:
        np.testing.assert_array_equal(end.parameters.final, plain.parameters.final)
    assert ends[0].parameters.names[0][0] == "initial mean a"


def test_a_bias_that_tests_share_widens_the_error_of_what_it_is_mixed_with(tmp_path):
    bias = "estimate.common_bias={outputs: [z], first: {std: [0.3]}, walk: {std: [0]}}"
    plain, shared = (estimated(opened(tmp_path, *more), "batch-ml").estimate for more in ((), (bias,)))
    before, after = plain.parameters.standard_errors, shared.parameters.standard_errors
    # x1 and the bias are seen as a sum: their variances add, within the change of the estimates themselves.
    assert after[0] == pytest.approx(np.hypot(before[0], 0.3), rel=0.1)
    np.testing.assert_allclose(after[1:], before[1:], rtol=0.15)


def test_unknown_variances_of_the_noise_are_found_beside_the_first_state(tmp_path):
    more = ("estimate.parameters={rate: {start: 0.04, lower: 0}}",
            "estimate.process_noise={start: {diag: [0.4], unit: density}, structure: diagonal}",
            "estimate.measurement_noise={start: {diag: [0.01]}, structure: diagonal}")  # fmt: skip
    found = estimated(opened(tmp_path, *more), "batch-ml").estimate.parameters
    assert [name for name, _, _ in found.names][-2:] == ["variance w", "variance z"]
    # q = 0.02 and a density of 1 is the same as any other product of 0.02.
    off = (found.final[-2:] - [1.0, 0.0025]) / found.standard_errors[-2:]
    assert np.all(np.abs(off) < 4)
    assert np.all(found.standard_errors[-2:] < [0.5, 0.002])


@pytest.mark.parametrize(
    ("more", "method", "said"),
    [
        (("estimate.initial_mean={known: [0, 0]}",), "batch-ml", "give both initial_mean and initial_cov"),
        (("estimate.parameters.q.upper=3",), "batch-ml", "know the bound `lower: 0` only"),
        (("estimate.parameters={q: {start: 1, lower: 0}, rate: {start: 1}}",), "batch-ml", "all positive"),
        (("estimate.tests.last=40",), "batch-ml", "tests 1 to 40, but dataset .* has 12"),
        (("estimate.parameters={}",), "em", "driven by white noise"),
        (("estimate.parameters={}", "model.discretisation=exact", "estimate.initial_map={names: [a, b], "
          "matrix: [[1, 0], [0, 1], [0, 0]]}"), "em", "takes neither estimate.initial_map nor"),
        (("estimate.parameters={}", "model.discretisation=exact"), "em", "takes the mean and covariance of"),
        (("estimate.continue_from=nothing",), "recursive-ml", "nothing.*name a result of recursive-ml"),
        (("estimate.methods.recursive-ml.first=30",), "recursive-ml", "batch of 30 tests, but there are 12"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_in_words(tmp_path, more, method, said):
    with pytest.raises((EstimationError, ConfigError)) as caught:
        estimated(opened(tmp_path, *more), method)

    assert re.search(said, str(caught.value)), str(caught.value)


def test_a_result_without_a_state_is_no_place_to_go_on_from(tmp_path):
    context = opened(tmp_path)
    estimated(context, "batch-ml")
    path = estimate_units(context, ["batch-ml"])[0].path
    with pytest.raises(EstimationError, match="nothing goes on from"):
        estimated(opened(tmp_path, f"estimate.continue_from={path}"), "recursive-ml")


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("estimate.initial_map={names: [a], matrix: [[1], [0]]}", "has 2 rows, but the model has 3 states"),
        ("estimate.initial_map={names: [a, b], matrix: [[1], [0], [0]]}", "has 1 numbers, but there are 2 names"),
        ("estimate.initial_map={names: [a, b]}", "give either matrix"),
        ("estimate.common_bias={outputs: [y], first: {std: [1]}}", "y is not one of the model's outputs: z"),
        ("estimate.common_bias={outputs: [z], first: {std: [1, 2]}}", "has 2 entries for 1 outputs"),
        ("estimate.tests={first: 5, last: 2}", "must be at least first, 5, not 2"),
        ("estimate.initial_mean={start: [0, 0, 0]}", "states with a free first value: x1, x2"),
        ("simulate.initial_covariance={diag: [1]}", "states with a free first value: x1, x2"),
        ("simulate.process_noise.unit=per_sample", "driven by white noise, whose covariance is a density"),
    ],
)
def test_settings_that_do_not_fit_are_told_with_their_place(tmp_path, setting, said):
    with pytest.raises(ConfigError) as caught:
        opened(tmp_path, setting)
    assert said in str(caught.value)


def test_the_first_sample_is_not_measured_and_the_loop_is_closed(tmp_path):
    dataset = made(opened(tmp_path))
    for r in dataset.recordings:
        assert np.isnan(r.y[0]).all()
        assert np.isfinite(r.y[1:]).all()
        assert np.isfinite(r.u).all()
        assert np.any(r.u[1:])
    np.testing.assert_array_equal(dataset.Q_true, [[1.0]])
    assert len({r.x_true[0, 0] for r in dataset.recordings}) == len(dataset.recordings)
    assert {f.name for f in fields(dataset)} >= {"Q_true", "R_true"}


def test_a_law_of_the_first_state_on_the_boundary_is_no_obstacle(tmp_path):
    """A singular Sigma that rounding has made indefinite still starts the filter of a nonlinear model."""
    context = opened(tmp_path, "estimate.initial_covariance.structure=full")
    posed = ensemble(task(context, made(context)))
    direction = np.array([1.0, 1e-4])
    Sigma = np.outer(direction, direction) - 1e-13 * np.diag(direction**2)
    theta = replace(posed.start, Sigma=Sigma)
    assert np.linalg.eigvalsh(Sigma)[0] < 0
    P0 = posed.noise(theta).P0[:2, :2]
    np.testing.assert_allclose(P0, Sigma, rtol=1e-12)
    assert np.linalg.eigvalsh(P0)[0] >= -4e-16

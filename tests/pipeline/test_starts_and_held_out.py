"""Starts drawn from the seed, and the tests that estimates are scored on."""

from pathlib import Path

import numpy as np
import pytest

from noiseid_cli.errors import ConfigError, EstimationError
from noiseid_cli.pipeline.context import open_experiment
from noiseid_cli.pipeline.datasets import make_dataset
from noiseid_cli.pipeline.estimation import make_estimate
from noiseid_cli.pipeline.starts import starts
from noiseid_cli.pipeline.units import dataset_units, estimate_units

STUDY = Path(__file__).parents[2] / "configs" / "axelsson2011.yaml"
SMALL = ("simulate.samples=120", "simulate.held_out.tests=2", "estimate.starts.draw.count=2")


def opened(root, *overrides, seed=None, file=STUDY):
    return open_experiment(file, root, (*SMALL, *overrides), seed)


def test_a_drawn_start_depends_on_seed_and_number_only(tmp_path):
    few, many = starts(opened(tmp_path)), starts(opened(tmp_path, "estimate.starts.draw.count=50"))
    assert many[:2] == few
    assert starts(opened(tmp_path, seed=1))[0].factors != few[0].factors
    logs = np.log10([s.factors for s in many])
    assert np.all(np.abs(logs) <= 3)
    # 200 uniform draws on [-3, 3]: mean 0 +- 1.73/sqrt(200), standard deviation 1.73 within a few per cent.
    assert abs(logs.mean()) < 4 * 1.73 / np.sqrt(200)
    assert abs(logs.std() / np.sqrt(3) - 1) < 0.15


def test_log_normal_factors_have_the_spread_asked_for(tmp_path):
    context = opened(
        tmp_path, "estimate.starts.draw.count=100", "estimate.starts.draw.factors={kind: log_normal, spread: 10}"
    )
    logs = np.log10([s.factors for s in starts(context)])
    assert abs(logs.std() - 1) < 4 / np.sqrt(2 * logs.size)


def test_drawn_factors_scale_the_start(tmp_path):
    context = opened(tmp_path)
    unit = estimate_units(context, ["em"])[1]
    for dataset in dataset_units(context):
        make_dataset(context, dataset)
    result = make_estimate(context, unit)
    stated = np.array([50.0, 20.0, 30.0, 15.0]) ** 2
    assert np.allclose(np.diag(result.estimate.start.Q), stated * unit.start.factors, rtol=1e-14)
    assert result.start_label == "drawn 1"


def test_held_out_tests_are_others_than_the_data(tmp_path):
    context = opened(tmp_path)
    data, held_out = dataset_units(context)
    own, other = make_dataset(context, data), make_dataset(context, held_out)
    assert [len(own.recordings), len(other.recordings)] == [1, 2]
    assert not np.allclose(own.recordings[0].z_true[0], other.recordings[0].z_true[0])
    assert not np.array_equal(other.recordings[0].y, other.recordings[1].y)
    result = make_estimate(context, estimate_units(context, ["em"])[0])
    assert list(result.held_out) == ["start", "estimate", "truth"]
    assert result.held_out_tests == 2
    assert len(result.held_out["truth"].path_error) == 240
    # A filter at the truth is consistent on tests that it has not seen: 2 tests of 120 samples and 4 outputs.
    assert abs(result.held_out["truth"].nis - 1) < 4 * np.sqrt(2 / 960)


def test_held_out_tests_are_no_data_of_any_method(tmp_path):
    units = estimate_units(opened(tmp_path))
    assert {unit.dataset.name for unit in units} == {"replicate-000"}
    assert {unit.held_out.name for unit in units} == {"held-out"}


def test_the_key_of_a_unit_knows_what_it_was_scored_on(tmp_path):
    before, after = (
        estimate_units(opened(tmp_path, *more), ["em"])[0].path.name for more in ((), ("simulate.held_out.tests=3",))
    )
    assert before != after


@pytest.mark.parametrize("structure", ["full", "scale"])
def test_alg2_refuses_what_it_cannot_do(tmp_path, structure):
    said = rf"methods\.alg2: alg2 takes a process noise of structure diagonal, not {structure}: .*em, ml, alg3"
    with pytest.raises(ConfigError, match=said):
        opened(tmp_path, f"estimate.methods.alg2.structure={structure}")


def test_a_method_may_have_a_structure_of_its_own(tmp_path):
    context = opened(tmp_path)
    for dataset in dataset_units(context):
        make_dataset(context, dataset)
    full, diagonal = (make_estimate(context, estimate_units(context, [m])[0]).estimate for m in ("em", "em-diagonal"))
    assert full.settings["structure"] == "full"
    assert diagonal.settings["structure"] == "diagonal"
    assert np.count_nonzero(full.final.Q) == 16
    assert np.count_nonzero(diagonal.final.Q) == 4


@pytest.mark.parametrize(
    ("setting", "method", "said"),
    [
        ("estimate.measurement_noise={start: {std: [1, 1, 1, 1]}}", "alg3", r"estimate\.measurement_noise.*: em, ml"),
        ("estimate.parameters={m1: {start: 90}}", "em", r"em cannot estimate what estimate\.parameters .*: ml"),
    ],
)
def test_what_a_method_cannot_estimate_is_refused_with_those_that_can(tmp_path, setting, method, said):
    with pytest.raises(ConfigError, match=rf"estimate\.methods\.{method}: .*{said}"):
        opened(tmp_path, setting)
    # A method that the experiment does not list is asked for on the command line.
    context = opened(tmp_path, setting, "estimate.methods={ml: {}}")
    with pytest.raises(EstimationError, match=said):
        estimate_units(context, [method])

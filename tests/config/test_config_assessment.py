"""Settings of what is made of an estimate: refused where they do nothing or do not fit."""

import pytest

from noiseid_cli.config.check import check_against
from noiseid_cli.config.findings import ModelNames
from noiseid_cli.config.load import builtin_experiment, load_experiment
from noiseid_cli.errors import ConfigError


def loaded(*overrides):
    return load_experiment(builtin_experiment(), overrides)


def test_defaults_and_choices():
    assert loaded().experiment.estimate.uncertainty.method == "score"
    chosen = loaded("estimate.uncertainty={method: bootstrap, replicates: 30, level: 0.9}").experiment.estimate
    assert (chosen.uncertainty.replicates, chosen.uncertainty.level) == (30, 0.9)
    assert loaded("estimate.holdout.last=0.25").experiment.estimate.holdout.last == 0.25


@pytest.mark.parametrize(
    ("override", "place", "words"),
    [
        ("estimate.uncertainty.replicates=50", "estimate.uncertainty.replicates", "goes with method bootstrap"),
        ("estimate.uncertainty={method: bootstrap, replicates: 5}", "estimate.uncertainty.replicates", "10"),
        ("estimate.uncertainty.level=1", "estimate.uncertainty.level", "less than 1"),
        ("estimate.holdout.last=0", "estimate.holdout.last", "greater than 0"),
        ("estimate.tuning={process_noise: {std: [1, 1, 1, 1]}}", "estimate.tuning.measurement_noise", "missing"),
    ],
)
def test_what_does_nothing_is_refused_at_its_place(override, place, words):
    with pytest.raises(ConfigError) as caught:
        loaded(override)
    assert any(place in str(problem) and words in str(problem) for problem in caught.value.problems)


def test_two_kinds_of_held_out_data_are_refused():
    with pytest.raises(ConfigError, match="held_out makes tests to score on already"):
        loaded("estimate.holdout.last=0.3", "simulate.held_out={trajectory: {kind: zero}, tests: 1}")


@pytest.mark.parametrize(
    ("tuning", "words"),
    [
        ("{process_noise: {std: [1]}, measurement_noise: {std: [1, 1, 1, 1]}}", "has 1 entry"),
        ("{process_noise: {std: [1, 1, 1, 1]}, measurement_noise: {std: [1, 1, 0, 1]}}", "must not be 0"),
    ],
)
def test_a_tuning_must_fit_the_model(tuning, words):
    names = ModelNames(
        states=tuple("abcdefgh"), inputs=("u1", "u2"), noises=tuple("wxyz"), outputs=("y1", "y2", "y3", "y4"),
        parameters=(), sample_time=5e-4, discretisation="euler",
    )  # fmt: skip
    found = check_against(loaded(f"estimate.tuning={tuning}"), names)
    assert any("estimate.tuning" in str(problem) and words in str(problem) for problem in found)

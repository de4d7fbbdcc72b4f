"""Tied variances in experiments, and methods that are asked for what they cannot do."""

import numpy as np
import pytest
from pydantic import ValidationError

from noiseid_cli.config.check_methods import refusal, wanted
from noiseid_cli.config.methods import KINDS, METHOD_OPTIONS
from noiseid_cli.config.schema_estimate import Estimate
from noiseid_cli.pipeline.problem import _covariance

KNOWN = {
    "process_noise": {"known": {"std": [1.0, 1.0]}},
    "measurement_noise": {"known": {"std": [1.0]}},
    "initial_mean": {"known": [0.0]},
    "initial_covariance": {"known": {"std": [1.0]}},
}


def section(**changes):
    return Estimate.model_validate(KNOWN | changes)


def noise(**more):
    return {"process_noise": {"start": {"std": [2.0, 2.0]}} | more}


@pytest.mark.parametrize(
    ("more", "place", "said"),
    [
        ({"tied": [["a", "b"]], "fixed": ["b"]}, ("tied", 0, 1), "b is fixed"),
        ({"tied": [["a", "b"], ["b", "c"]]}, ("tied", 1, 0), "b is tied already"),
        ({"tied": [["a", "b"]], "structure": "scale"}, ("tied",), "nothing can be tied"),
        ({"tied": [["a"]]}, (), "at least 2"),
    ],
)
def test_ties_that_make_no_sense_are_refused(more, place, said):
    with pytest.raises(ValidationError, match=said) as caught:
        section(**noise(**more))
    assert place == () or place in [e["ctx"]["at"] for e in caught.value.errors()]


def test_tied_variances_start_at_one_value_whatever_the_factors():
    choice = section(**noise(tied=[["a", "b"]])).process_noise
    start, structure = _covariance(choice, ("a", "b"), "process_noise", (4.0, 9.0))
    np.testing.assert_array_equal(np.diag(start), [16.0, 16.0])
    assert structure.tied == ((0, 1),)
    structure.check()


def test_what_is_asked_is_read_from_the_section():
    assert wanted(section(**noise())) == {"Q"}
    parameters = {"parameters": {"J": {"start": 1.0}}, "initial_mean": {"start": [0.0]}}
    assert wanted(section(**noise(), **parameters)) == {"Q", "m0", "parameters"}


@pytest.mark.parametrize("name", METHOD_OPTIONS)
def test_a_method_refuses_each_kind_that_it_cannot_estimate(name):
    # Without validation: some have settings that must be given.
    options = METHOD_OPTIONS[name].model_construct(method=name)
    start = {"start": {"std": [1.0]}}
    asked = {
        "R": {"measurement_noise": start},
        "m0": {"initial_mean": {"start": [0.0]}},
        "P0": {"initial_covariance": start},
        "parameters": {"parameters": {"J": {"start": 1.0}}},
    }
    for change in asked.values():
        posed = section(**noise(structure="diagonal"), **change)
        why = refusal(options, posed)
        beyond = wanted(posed) - options.can
        assert (why == "") == (not beyond)
        if why:
            assert why.startswith(f"{name} cannot estimate what estimate.")
            assert all(f"estimate.{KINDS[kind]}" in why for kind in beyond)
            assert "ml" in why.split("can: ")[1]


def test_a_method_of_q_alone_needs_an_unknown_q_of_its_structure():
    R = {"measurement_noise": {"start": {"std": [1.0]}}}
    assert "measurement_noise" in refusal(METHOD_OPTIONS["alg3"](), section(**R))
    why = refusal(METHOD_OPTIONS["alg2"](), section(**noise()))
    assert why == (
        "alg2 takes a process noise of structure diagonal, not full: change that, "
        "or take a method that can: em, ml, alg3"
    )
    assert refusal(METHOD_OPTIONS["alg2"](structure="diagonal"), section(**noise())) == ""

"""The options in experiment files are the options of the estimators, with the same defaults."""

import dataclasses
import importlib
import re

import pytest
from pydantic import ValidationError

from noiseid_cli.config.methods import METHOD_OPTIONS
from noiseid_cli.filters.sigma_points import unscented
from noiseid_cli.pipeline.methods import filter_of

ELSEWHERE = {  # module, class, options that only one side has
    "asrukf": ("adaptive_srukf", "AdaptiveOptions", {"monitor", "thresholds"}),
    "sb-asrukf": ("adaptive_srukf", "AdaptiveOptions", {"monitor"}),
    "joint-srukf": ("joint_srukf", "JointOptions", {"hold_process_noise"}),
    "batch-ml": ("cross_sectional.batch", "BatchOptions", {"at_tests"}),
    "recursive-ml": ("cross_sectional.recursive_state", "RecursiveOptions", set()),
}


def default_of(field):
    """Default of a dataclass field; None stands for one that must be given."""
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return None if field.default is dataclasses.MISSING else field.default


@pytest.mark.parametrize("name", METHOD_OPTIONS)
def test_options_are_those_of_the_estimator(name):
    module, options, own = ELSEWHERE.get(name, (name, f"{name.capitalize()}Options", set()))
    found = getattr(importlib.import_module(f"noiseid_cli.estimators.{module}"), options)
    theirs = {field.name: default_of(field) for field in dataclasses.fields(found) if field.name not in own}
    fields = METHOD_OPTIONS[name].model_fields.items()
    ours = {k: None if f.is_required() else f.default for k, f in fields if k not in {"method", "structure", *own}}
    assert ours == theirs


@pytest.mark.parametrize("name", METHOD_OPTIONS)
def test_every_method_says_what_it_does(name):
    options = METHOD_OPTIONS[name]
    assert options.summary
    assert options.estimates
    assert re.search(r"\b(19|20)\d\d\b", options.citation)
    assert options.can
    assert options.structures


@pytest.mark.parametrize(
    ("options", "place", "words"),
    [
        ({"alpha": 0.5}, "alpha", "goes with smoother unscented, not extended"),
        ({"smoother": "cubature", "kappa": 1.0}, "kappa", "goes with smoother unscented, not cubature"),
        ({"smoother": "unscented", "linearisation": "filtered"}, "linearisation", "goes with smoother extended"),
    ],
)
def test_an_option_that_the_smoother_does_not_read_is_refused(options, place, words):
    with pytest.raises(ValidationError, match=words) as caught:
        METHOD_OPTIONS["em"].model_validate(options)
    assert place in str(caught.value.errors())


def test_the_smoother_of_em_is_the_filter_of_its_evaluations():
    options = METHOD_OPTIONS["em"].model_validate({"smoother": "unscented", "alpha": 0.5, "kappa": 1.0})
    assert filter_of(options, 2) == ("unscented", unscented(2, 0.5, 2.0, 1.0))
    assert filter_of(METHOD_OPTIONS["alg3"](), 2) == ("extended", None)


def test_the_filter_of_the_adaptive_methods_is_unscented():
    options = METHOD_OPTIONS["asrukf"].model_validate({"alpha": 0.3, "kappa": 1.0, "parameter_covariance": {"J": 1.0}})
    assert filter_of(options, 2) == ("unscented", unscented(2, 0.3, 2.0, 1.0))
    joint = {"kappa": -3.0, "parameter_covariance": {"J": 1.0}, "parameter_noise": {"J": 0.0}}
    # That kappa is meant for states and parameters together.
    assert filter_of(METHOD_OPTIONS["joint-srukf"].model_validate(joint), 2) == ("unscented", unscented(2, 0.85))

"""The options in experiment files are the options of the estimators, with the same defaults."""

import dataclasses
import importlib
import re

import pytest
from pydantic import ValidationError

from noiseid_cli.config.methods import METHOD_OPTIONS
from noiseid_cli.filters.sigma_points import unscented
from noiseid_cli.pipeline.methods import filter_of


@pytest.mark.parametrize("name", METHOD_OPTIONS)
def test_options_are_those_of_the_estimator(name):
    module = importlib.import_module(f"noiseid_cli.estimators.{name}")
    options = getattr(module, f"{name.capitalize()}Options")
    theirs = {field.name: field.default for field in dataclasses.fields(options)}
    ours = {k: f.default for k, f in METHOD_OPTIONS[name].model_fields.items() if k not in ("method", "structure")}
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

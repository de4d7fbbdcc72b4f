"""The options in experiment files are the options of the estimators, with the same defaults."""

import dataclasses
import importlib

import pytest

from noiseid_cli.config.methods import METHOD_OPTIONS


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
    assert "2011" in options.citation

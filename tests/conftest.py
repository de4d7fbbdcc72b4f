"""Shared test set-up: the oracles are importable as modules of their own; generated examples are always the same."""

import sys
from pathlib import Path

import pytest
from fuzz import fuzzing
from hypothesis import HealthCheck, settings

sys.path.insert(0, str(Path(__file__).parent / "oracles"))

# A busy machine makes generating examples slow, and no statement of ours is about that.
settings.register_profile(
    "noiseid",
    deadline=None,
    derandomize=not fuzzing(),  # there the seed is given
    database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
settings.load_profile("noiseid")


@pytest.fixture
def tried(request):
    """A function that a test calls with each input; `make fuzz` tells how often that was."""
    count = 0

    def count_one():
        nonlocal count
        count += 1

    yield count_one
    request.node.user_properties.append(("inputs", count))

"""The small experiment of the command tests serves here too."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "commands"))


@pytest.fixture
def small(tmp_path):
    """The experiment file of the small experiment."""
    from small_experiment import write_experiment

    return write_experiment(tmp_path)

"""Shared test set-up: the oracles are importable as modules of their own; generated examples are always the same."""

import sys
from pathlib import Path

from hypothesis import HealthCheck, settings

sys.path.insert(0, str(Path(__file__).parent / "oracles"))

# A busy machine makes generating examples slow, and no statement of ours is about that.
settings.register_profile(
    "noiseid",
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
settings.load_profile("noiseid")

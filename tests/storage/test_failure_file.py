"""Records of failed units: kept, counted, forgotten, and never trusted."""

import json
from pathlib import Path

import pytest

from noiseid_cli.storage.failure_file import failure_path, forget_failure, read_failure, record_failure


def record(path, reason="it rained", tries=1):
    record_failure(path, "replicate-000", reason, tries, "ab" * 32, {"experiment": "small"})


def test_a_record_stands_beside_the_file_and_counts_the_tries(tmp_path):
    path = tmp_path / "replicate-000-abababab.h5"
    assert read_failure(path) is None
    record(path)
    record(path, "it snowed \ud800", tries=3)
    assert failure_path(path) == tmp_path / "replicate-000-abababab.failed.json"
    found = read_failure(path)
    assert (found.unit, found.tries) == ("replicate-000", 4)
    assert found.reason.startswith("it snowed")
    assert json.loads(failure_path(path).read_text())["config"] == {"experiment": "small"}
    forget_failure(path)
    forget_failure(path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "{}", "[" * 100_000, '{"format": "noiseid-failure", "format_version": 99}', '{"format": "other"}'],
)
def test_a_record_that_is_not_ours_is_none(tmp_path, text):
    path = tmp_path / "a.h5"
    failure_path(path).write_text(text)
    assert read_failure(path) is None


def test_the_name_of_a_unit_may_hold_dots():
    assert failure_path(Path("results/a.em.start-0-12.h5")) == Path("results/a.em.start-0-12.failed.json")

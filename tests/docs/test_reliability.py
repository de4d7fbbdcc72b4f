"""Every promise of docs/reliability.md names a test that is there."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_every_promise_has_its_test():
    rows = re.findall(r"^\| (.+) \| `(.+)::(.+)` \|$", (ROOT / "docs/reliability.md").read_text(), re.MULTILINE)
    assert len(rows) > 20
    for promise, file, name in rows:
        assert f"def {name}(" in (ROOT / "tests" / file).read_text(), promise

"""The JSON Schema agrees with the loader on good and on bad experiments."""

import json
import re
from pathlib import Path

import pytest

from noiseid_cli.config.json_schema import json_schema
from noiseid_cli.config.load import builtin_experiment, load_experiment
from noiseid_cli.config.yaml_loader import read_yaml

SCHEMA = json_schema()
SHIPPED = [builtin_experiment(), *sorted(Path("configs").glob("*.yaml"))]

TYPES = {
    "object": lambda v: isinstance(v, dict),
    "array": lambda v: isinstance(v, list),
    "string": lambda v: isinstance(v, str),
    "boolean": lambda v: isinstance(v, bool),
    "null": lambda v: v is None,
    "number": lambda v: isinstance(v, int | float) and not isinstance(v, bool),
    "integer": lambda v: isinstance(v, int | float) and not isinstance(v, bool) and v == int(v),
}
CHECKS = {
    "type": lambda v, s: TYPES[s](v),
    "const": lambda v, s: v == s,
    "enum": lambda v, s: v in s,
    "required": lambda v, s: not isinstance(v, dict) or all(k in v for k in s),
    "minimum": lambda v, s: not TYPES["number"](v) or v >= s,
    "maximum": lambda v, s: not TYPES["number"](v) or v <= s,
    "exclusiveMinimum": lambda v, s: not TYPES["number"](v) or v > s,
    "exclusiveMaximum": lambda v, s: not TYPES["number"](v) or v < s,
    "minLength": lambda v, s: not isinstance(v, str) or len(v) >= s,
    "maxLength": lambda v, s: not isinstance(v, str) or len(v) <= s,
    "pattern": lambda v, s: not isinstance(v, str) or re.search(s, v),
    "minItems": lambda v, s: not isinstance(v, list) or len(v) >= s,
    "maxItems": lambda v, s: not isinstance(v, list) or len(v) <= s,
    "minProperties": lambda v, s: not isinstance(v, dict) or len(v) >= s,
    "propertyNames": lambda v, s: not isinstance(v, dict) or all(valid(k, s) for k in v),
    "anyOf": lambda v, s: any(valid(v, n) for n in s),
    "oneOf": lambda v, s: sum(valid(v, n) for n in s) == 1,
    "$ref": lambda v, s: valid(v, SCHEMA["$defs"][s.removeprefix("#/$defs/")]),
    "items": lambda v, s: not isinstance(v, list) or all(valid(e, s) for e in v),
    "prefixItems": lambda v, s: not isinstance(v, list) or all(map(valid, v, s)),
}
STRUCTURE = {"properties", "patternProperties", "additionalProperties"}
ANNOTATIONS = {"title", "description", "default", "$schema", "$defs", "discriminator"}


def valid(value, node):
    """A small JSON Schema validator: the words that the schema uses, and no others."""
    assert set(node) <= set(CHECKS) | STRUCTURE | ANNOTATIONS, set(node)
    if not all(CHECKS[word](value, node[word]) for word in set(node) & set(CHECKS)):
        return False
    if not isinstance(value, dict):
        return True
    for key, entry in value.items():
        nodes = [node["properties"][key]] if key in node.get("properties", {}) else []
        nodes += [n for p, n in node.get("patternProperties", {}).items() if re.search(p, key)]
        others = node.get("additionalProperties", True)
        if not nodes and others is False:
            return False
        nodes += [others] if not nodes and isinstance(others, dict) else []
        if not all(valid(entry, n) for n in nodes):
            return False
    return True


@pytest.mark.parametrize("file", SHIPPED, ids=lambda f: f.name)
def test_shipped_experiments_pass(file):
    assert valid(read_yaml(file).data, SCHEMA)
    assert valid(load_experiment(file).resolved(), SCHEMA)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("seed: 2012", "sed: 2011"),
        ("seed: 2012", "seed: -1"),
        ("experiment: flexible_robot", "experiment: ../x"),
        ("samples: 4000", "samples: 4000.5"),
        ("samples: 4000", "samples: '4000'"),
        ("kind: square", "kind: circle"),
        ("side: 0.2,", "side: 0,"),
        ("{std: [50, 20, 30, 15]}     ", "{std: [1], diag: [1]}"),
        ("structure: full", "structure: fall"),
        ("known: truth", "known: true"),
        ("em: {}", "em: {max_passes: 0}"),
        ("em: {}", "a/b: {method: em}"),
        ("title: Flexible robot, process noise by EM", "formats: [pdf]"),
        ("report:", "import: {recordings: {a: {file: b}}}\nreport:"),
    ],
)
def test_wrong_experiments_fail(tmp_path, old, new):
    text = builtin_experiment().read_text()
    assert old in text
    (tmp_path / "e.yaml").write_text(text.replace(old, new, 1))
    assert not valid(read_yaml(tmp_path / "e.yaml").data, SCHEMA)


def test_every_setting_is_described():
    for name, node in [("Experiment", SCHEMA), *SCHEMA["$defs"].items()]:
        for key, entry in node.get("properties", {}).items():
            assert entry.get("description"), f"{name}.{key}"
        assert node.get("additionalProperties") is False, name


def test_shorthands_pass():
    data = read_yaml(Path("configs/double_pendulum_measured.yaml")).data
    data["import"]["inputs"] = {"tau1": "tau_meas1", "tau2": 7}
    data["estimate"]["methods"] = {"em": None}
    assert valid(data, SCHEMA)
    data["import"]["inputs"]["tau2"] = 1.5
    assert not valid(data, SCHEMA)


def test_it_is_json_and_says_which_draft():
    assert json.loads(json.dumps(SCHEMA))["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    assert SCHEMA["title"] == "noiseid experiment"
    json_schema()["properties"].clear()
    assert json_schema()["properties"]

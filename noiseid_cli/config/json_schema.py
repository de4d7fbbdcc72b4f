"""The JSON Schema of an experiment file, for editors; also what error messages take their hints from."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from functools import cache
from typing import Any

from noiseid_cli.config.document import Path, value_at

Schema = dict[str, Any]


def json_schema() -> Schema:
    """Give the JSON Schema (draft 2020-12): every setting with its unit, closed choices, no unknown keys."""
    return copy.deepcopy(_schema())


@cache
def _schema() -> Schema:
    from noiseid_cli.config.methods import METHOD_OPTIONS
    from noiseid_cli.config.schema import Experiment

    schema = Experiment.model_json_schema()
    definitions = schema["$defs"]
    definitions.pop("MethodOptions")
    for options in METHOD_OPTIONS.values():
        definition = options.model_json_schema()
        definitions.update(definition.pop("$defs", {}))
        definitions[options.__name__] = definition
    choices = [{"$ref": f"#/$defs/{options.__name__}"} for options in METHOD_OPTIONS.values()]
    methods = definitions["Estimate"]["properties"]["methods"]
    for pattern in methods["patternProperties"]:
        methods["patternProperties"][pattern] = {"anyOf": [*choices, {"type": "null"}]}
    _close(schema)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def _close(node: Any) -> None:
    """Forbid keys that fit no pattern, and drop the titles that pydantic derives from the keys."""
    if isinstance(node, list):
        for entry in node:
            _close(entry)
    if isinstance(node, dict):
        if "patternProperties" in node:
            node["additionalProperties"] = False
        for properties in (node.get("properties", {}), node.get("$defs", {})):
            for entry in properties.values():
                entry.pop("title", None)
        for entry in node.values():
            _close(entry)


def description(path: Path, data: Any) -> str:
    """Give what the schema says about the setting at a path; empty where it is not known."""
    return next((node["description"] for node in _at(path, data) if "description" in node), "")


def known_keys(path: Path, data: Any) -> list[str]:
    """Give the keys that the mapping at a path may have; empty where any name is allowed."""
    nodes = [variant for node in _at(path, data) for variant in _variants(node, value_at(data, path))]
    return list(dict.fromkeys(key for node in nodes for key in node.get("properties", {})))


def known_kinds(path: Path, data: Any) -> list[str]:
    """Give the values that ``kind`` may have in the mapping at a path."""
    return [node["const"] for node in _at((*path, "kind"), data) if "const" in node]


def _at(path: Path, data: Any) -> list[Schema]:
    """Give the nodes of the schema that apply at a path of the data."""
    nodes = [_schema()]
    for depth, step in enumerate(path):
        value = value_at(data, path[:depth])
        nodes = [child for node in nodes for variant in _variants(node, value) for child in _children(variant, step)]
    return nodes


def _variants(node: Schema, value: Any) -> Iterator[Schema]:
    """Follow references and alternatives; of the trajectories only the one whose kind the data names."""
    if "$ref" in node:
        yield from _variants(_schema()["$defs"][node["$ref"].rsplit("/", 1)[1]], value)
    for variant in node.get("anyOf") or node.get("oneOf") or []:
        yield from _variants(variant, value)
    kind = node.get("properties", {}).get("kind", {}).get("const")
    if kind is None or not isinstance(value, dict) or value.get("kind") in (None, kind):
        yield node


def _children(node: Schema, step: str | int) -> list[Schema]:
    """Give the schema of one key or entry of a node."""
    if isinstance(step, int):
        entries = [node["items"]] if "items" in node else node.get("prefixItems", [])[step : step + 1]
        return list(entries)
    if step in node.get("properties", {}):
        return [node["properties"][step]]
    others = [*node.get("patternProperties", {}).values(), node.get("additionalProperties")]
    return [other for other in others if isinstance(other, dict)]

"""From what pydantic found to a path in the file and a sentence."""

from __future__ import annotations

import re
from typing import Any

from noiseid_cli.config.document import Document, Fault, Path, value_at
from noiseid_cli.config.json_schema import description, known_keys, known_kinds
from noiseid_cli.config.suggest import did_you_mean
from noiseid_cli.errors import Problem

_KINDS = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "int_parsing_size": "a smaller whole number",
    "finite_number": "a finite number",
    "bool_type": "true or false",
    "string_type": "text",
    "tuple_type": "a list, such as [1, 2]",
    "dict_type": "a mapping, such as {key: value}",
    "model_type": "a mapping, such as {key: value}",
    "model_attributes_type": "a mapping, such as {key: value}",
}
_BOUNDS = {
    "greater_than": ("greater than", "gt"),
    "greater_than_equal": ("at least", "ge"),
    "less_than": ("less than", "lt"),
    "less_than_equal": ("at most", "le"),
}


def to_problem(error: Any, document: Document) -> Problem | None:
    """Turn one entry of ``ValidationError.errors()`` into a problem with its place.

    Returns:
        The problem; None where the value could not be read, which the document has complained about already.
    """
    kind, context, value = error["type"], error.get("ctx", {}), error["input"]
    own = context["at"] if kind == "refused" else ()
    path, inside = _data_path((*error["loc"], *own), document.data)
    if inside and kind != "extra_forbidden":
        return None
    if kind == "too_short" and len(value) >= context["min_length"]:
        return None  # entries that are wrong themselves were not counted: each has its own complaint
    if kind == "refused":
        message, at_key = context["message"], isinstance(value_at(document.data, path), dict)
    elif kind == "missing":
        path, message = _missing(path, document.data)
        at_key = True
    elif kind == "extra_forbidden":
        message, at_key = _unknown_key(path, document.data), True
    elif kind in ("union_tag_invalid", "union_tag_not_found"):
        message, at_key = _wrong_kind(path, context, document.data), False
        path = (*path, "kind")
    elif error["loc"][-1:] == ("[key]",):
        message, at_key = _text_rule(kind, context, path[-1]), True
    else:
        message, at_key = _wrong_value(kind, context, value, error["msg"]), False
        hint = description(path, document.data)
        if hint and kind != "string_pattern_mismatch":
            message += f" ({hint})"
    return document.problem(path, message, at_key=at_key)


def _data_path(loc: tuple[str | int, ...], data: Any) -> tuple[Path, bool]:
    """Find the path in the data that pydantic's loc means; it also holds tags of unions, which are left out.

    Returns:
        The path, which may end with one key that is missing, and whether it lies in an unreadable value.
    """
    path: list[str | int] = []
    for i, step in enumerate(loc):
        if isinstance(data, Fault):
            return tuple(path), True
        last = i == len(loc) - 1
        tag = isinstance(data, dict) and data.get("kind") == step and not (last and step in data)
        if step == "[key]" or tag:
            continue
        if isinstance(data, dict) and step in data:
            path.append(step)
            data = data[step]
        elif isinstance(data, list) and isinstance(step, int):
            path.append(step)
            data = data[step] if step < len(data) else None
        elif last and isinstance(data, dict):
            path.append(step)
            data = None
    return tuple(path), isinstance(data, Fault)


def _missing(path: Path, data: Any) -> tuple[Path, str]:
    if isinstance(path[-1], int):  # a list of fixed length that is too short
        return path[:-1], f"has too few entries ({description(path[:-1], data)})"
    hint = description(path, data)
    return path, "is missing" + (f": {hint}" if hint else "")


def _unknown_key(path: Path, data: Any) -> str:
    key, known = str(path[-1]), known_keys(path[:-1], data)
    if ":" in key:
        return f"{key!r} is not a setting: is a blank missing after the colon?"
    return f"is not a setting here; known: {', '.join(known)}{did_you_mean(key, known)}"


def _wrong_kind(path: Path, context: dict[str, Any], data: Any) -> str:
    """Say what is wrong with the ``kind`` that decides which other settings a mapping has."""
    keys = list(value_at(data, path))
    if "kind" in keys:
        return _choice(_quoted(context["expected_tags"]), value_at(data, path)["kind"], "")
    guess = next((f"; is a blank missing after the colon in {key!r}?" for key in keys if ":" in key), "")
    return f"is missing: one of {', '.join(known_kinds(path, data))}{guess}"


def _wrong_value(kind: str, context: dict[str, Any], value: Any, message: str) -> str:
    """Say what is wrong with a value, in plain words."""
    if kind in _KINDS:
        if value is None:
            return f"is empty, but must be {_KINDS[kind]}"
        return f"must be {_KINDS[kind]}, not {shown(value)}{_number_hint(kind, value)}"
    if kind in _BOUNDS:
        words, bound = _BOUNDS[kind]
        return f"must be {words} {context[bound]:g}, not {shown(value)}"
    if kind == "literal_error":
        return _choice(_quoted(context["expected"]), value, context["expected"])
    if kind in ("too_short", "too_long"):
        return _wrong_length(kind, context)
    return _text_rule(kind, context, value) if kind.startswith("string_") else message


def _wrong_length(kind: str, context: dict[str, Any]) -> str:
    limit = context["min_length"] if kind == "too_short" else context["max_length"]
    what = "at least" if kind == "too_short" else "at most"
    entries = "entry" if limit == 1 else "entries"
    return f"must have {what} {limit} {entries}, not {context['actual_length']}"


def _text_rule(kind: str, context: dict[str, Any], value: Any) -> str:
    if kind == "string_pattern_mismatch":
        return (
            f"{shown(value)} is not a label: use letters, digits, dot, underscore and hyphen, "
            "starting with a letter or digit, at most 64"
        )
    if kind == "string_too_long":
        return f"must have at most {context['max_length']} characters"
    return "must not be empty"


def _choice(allowed: list[str], value: Any, otherwise: str) -> str:
    choices = ", ".join(allowed) or otherwise
    return f"must be one of {choices}, not {shown(value)}{did_you_mean(value, allowed)}"


def _quoted(text: str) -> list[str]:
    return re.findall(r"'([^']*)'", text)


def _number_hint(kind: str, value: Any) -> str:
    """Explain the texts that look like numbers to a reader but not to YAML 1.2."""
    if kind == "string_type" and isinstance(value, int | float):
        return ": put it in quotes"
    if kind not in ("float_type", "int_type") or not isinstance(value, str):
        return ""
    if re.fullmatch(r"[-+]?[0-9][0-9_]*(\.[0-9_]*)?", value) and "_" in value:
        return ": write it without underscores"
    if re.fullmatch(r"[-+]?[0-9.]+([eE][-+]?[0-9]+)?", value):
        return ": write it without quotes"
    if re.fullmatch(r"[0-9]+(:[0-9.]+)+", value):
        return ": give times in seconds"
    return ""


def shown(value: Any) -> str:
    """Show a value as it would be written, in a few words."""
    if value is None:
        return "empty"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f"the text {value if len(value) <= 40 else value[:40] + '...'!r}"
    if isinstance(value, int | float):
        return repr(value)
    return "a mapping" if isinstance(value, dict) else "a list"

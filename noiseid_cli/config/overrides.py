"""Settings from the command line: ``--set a.b=VALUE``, laid over the file before it is checked."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from noiseid_cli.config.document import Document, Path, Place, dotted
from noiseid_cli.config.yaml_loader import parse_value
from noiseid_cli.errors import Problem

_PART = re.compile(r'"([^"]+)"|([^."]+)')


Origin = str | Place
"""Where a value comes from: an argument of the command line, or a place in the file."""


class PathError(ValueError):
    """The path of an override leads nowhere."""


def apply(document: Document, overrides: Iterable[str], seed: int | None = None) -> list[Problem]:
    """Lay overrides over the data of a document, in their order.

    Args:
        document: changed in place: its data, and where each setting comes from.
        overrides: texts ``a.b=VALUE``; entries of a list are counted from 0, a name that holds a dot goes in
            double quotes. VALUE follows the same rules as the file.
        seed: replaces the setting ``seed`` where given.

    Returns:
        What is wrong with them; a faulty one is left out.
    """
    problems = []
    for text in overrides:
        source = f"--set {text}"
        left, equals, right = text.partition("=")
        try:
            if not equals:
                raise PathError("must be of the form PATH=VALUE, such as simulate.samples=500")
            path = parse_path(left)
            value, wrong = parse_value(right, source)
            if wrong:
                raise PathError("; ".join(wrong))
            put(document, path, value, source)
        except PathError as error:
            problems.append(Problem(1, 1, "", str(error), source=source))
    if seed is not None and isinstance(document.data, dict):
        put(document, ("seed",), seed, f"--seed {seed}")
    return problems


def parse_path(text: str) -> tuple[str, ...]:
    """Split ``a."b.c".0`` into its parts.

    Raises:
        PathError: the text is no path.
    """
    parts, at = [], 0
    text = text.strip()
    while match := _PART.match(text, at):
        parts.append((match[1] or match[2]).strip())
        at = match.end()
        if at == len(text) and all(parts):
            return tuple(parts)
        if text[at : at + 1] != ".":
            break
        at += 1
    raise PathError(f"{text!r} is not a path of settings, such as simulate.process_noise.std.0")


def put(document: Document, path: tuple[str, ...], value: Any, origin: Origin) -> None:
    """Set one value, with the mappings that lead to it where they are not there yet.

    Args:
        document: changed in place.
        path: the setting.
        value: its new value.
        origin: what complaints about it point at.

    Raises:
        PathError: the path leads nowhere.
    """
    if document.data is None:
        document.data = {}
    node, here = document.data, ()  # type: Any, Path
    for i, part in enumerate(path):
        last = i == len(path) - 1
        step = _step(node, part, here)
        here = (*here, step)
        if last:
            node[step] = value
        elif isinstance(node, dict) and node.get(step) is None:
            node[step] = {}
            if here not in document.places:
                _mark(document, here, origin)
        node = node[step]
    for known in (document.places, document.sources):
        for old in [p for p in known if p[: len(here)] == here]:
            del known[old]
    _mark(document, here, origin)


def _mark(document: Document, path: Path, origin: Origin) -> None:
    if isinstance(origin, str):
        document.sources.setdefault(path, origin)
    else:
        document.places.setdefault(path, origin)


def _step(node: Any, part: str, here: Path) -> str | int:
    """Turn a part of a path into a key or an index of the node that it stands in."""
    where = dotted(here) or "the file"
    if isinstance(node, dict):
        return part
    if not isinstance(node, list):
        raise PathError(f"{where} holds a single value: nothing can be set inside it")
    if not re.fullmatch("[0-9]{1,9}", part):
        raise PathError(f"{where} is a list: {part!r} must be the number of an entry, counted from 0")
    if int(part) >= len(node):
        raise PathError(f"{where} has {len(node)} entries: {part} must be 0 to {len(node) - 1}")
    return int(part)

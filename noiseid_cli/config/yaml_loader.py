"""Strict YAML: read to plain data with the place of every setting; nothing in a file can run, hang or surprise.

The events of PyYAML's own safe parser are turned into data here, so none of its constructors is ever reached:
no tags, no anchors, no merge keys, no dates, and one set of rules for numbers (see ``scalars``).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path as FilePath
from typing import Any, NoReturn

import yaml

from noiseid_cli.config.document import Document, Fault, Path, Place
from noiseid_cli.config.scalars import ScalarError, resolve
from noiseid_cli.errors import ConfigError, DataError, machine_error

MAX_BYTES = 1 << 20
MAX_DEPTH = 30
MAX_NODES = 20_000
_MAX_PROBLEMS = 50
_UNFIT_CHARACTER = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff]")

# PyYAML's own words, and what they usually mean to the writer of the file.
_SYNTAX = {
    "mapping values are not allowed": "a colon where none can stand: check the indentation, or quote the text",
    "could not find expected ':'": "this line has no `key: value`; a colon is followed by a blank",
    "expected <block end>": "the indentation does not fit the lines above",
    "expected ',' or ']'": "a list that was opened with [ is not closed, or a comma is missing",
    "expected ',' or '}'": "a mapping that was opened with { is not closed, or a comma is missing",
    "character '\\t'": "a tab: use spaces for the indentation",
    "unexpected end of stream": "a quote or bracket is not closed",
    "expected the node content": "a value is missing here",
    "sequence entries are not allowed": "a `-` where no list can start: put it on a line of its own",
    "expected <document start>": "text before or after the settings that does not belong to them",
    "expected '<document start>'": "text before or after the settings that does not belong to them",
    "unknown escape character": "an unknown escape after \\ in double quotes: use single quotes",
    "that cannot start any token": "a character that cannot start a value: put the text in quotes",
    "special characters are not allowed": "a control character",
}


def read_yaml(path: FilePath, shown: str | None = None) -> Document:
    """Read a YAML file.

    Args:
        path: the file.
        shown: its name in messages; the path as given when left out.

    Raises:
        DataError: there is no such file, or it is not a readable text file of at most 1 MiB.
        ConfigError: the text is not YAML within the limits.
    """
    shown = shown or str(path)
    try:
        if not path.exists():
            raise DataError(f"{shown}: there is no such file")
        if not path.is_file():
            kind = "a folder" if path.is_dir() else "not a regular file"
            raise DataError(f"{shown}: is {kind}; the experiment must be a YAML file")
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = getattr(error, "strerror", None) or str(error)
        fault = machine_error(error, f"{shown} cannot be read")
        raise fault or DataError(f"{shown!r}: cannot be read: {reason}") from error
    if len(content) > MAX_BYTES:
        raise DataError(f"{shown}: is larger than 1 MiB; is it an experiment file?")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        message = "is not UTF-8 text: save the file in UTF-8 encoding"
        raise ConfigError(shown, [Document(shown, "").problem_at(line, 1, message)]) from error
    return parse_yaml(text, shown)


def parse_yaml(text: str, file: str) -> Document:
    """Read a YAML text; faults that leave the rest readable are collected in ``problems``.

    Raises:
        ConfigError: the text is not YAML within the limits, so that nothing can be said about the rest.
    """
    document = Document(file, text)
    return _Builder(document).build()


def parse_value(text: str, file: str) -> tuple[Any, list[str]]:
    """Read one value by the same rules, such as the right side of ``--set a.b=VALUE``.

    Returns:
        The value and what is wrong with it, in sentences.
    """
    try:
        document = parse_yaml(text, file)
    except ConfigError as error:
        return None, [p.message for p in error.problems]
    return document.data, [p.message for p in document.problems]


class _Builder:
    """Turns the events of one text into data and places."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.nodes = 0

    def build(self) -> Document:
        """Read the one document of the text."""
        self.events = self._parse()
        while True:
            event = next(self.events)
            if isinstance(event, yaml.DocumentStartEvent):
                if event.version or event.tags:
                    self._stop(event, "directives (%YAML, %TAG) are not taken: remove them")
                break
            if isinstance(event, yaml.StreamEndEvent):
                return self.document
        first = next(self.events)
        self.document.places[()] = Place(_mark(first), _mark(first))
        self.document.data = self._node(first, (), 0)
        next(self.events)  # the end of the document
        event = next(self.events)
        if not isinstance(event, yaml.StreamEndEvent):
            self._stop(event, "a second document starts here: one file holds one experiment")
        return self.document

    def _parse(self) -> Iterator[Any]:
        """Yield the events; every way in which the parser can fail ends as a ConfigError."""
        mark = (1, 1)
        try:
            for event in yaml.parse(self.document.text, Loader=yaml.SafeLoader):
                mark = _mark(event)
                yield event
        except yaml.reader.ReaderError as error:
            before = self.document.text[: error.position]
            line = before.count("\n") + 1
            column = error.position - (before.rfind("\n") + 1) + 1
            self._fail(
                line,
                column,
                f"a control character, code {ord(self.document.text[error.position]):#x}: remove it",
            )
        except yaml.MarkedYAMLError as error:
            at = error.problem_mark or error.context_mark
            if "could not find expected ':'" in str(error.problem):  # noticed on the line after the one at fault
                at = error.context_mark or at
            line, column = (at.line + 1, at.column + 1) if at else mark
            self._fail(line, column, "not valid YAML: " + _plain_words(str(error.problem)))
        except (ValueError, OverflowError):  # a code beyond Unicode, a version number without end
            self._fail(*mark, "not valid YAML: a character code or version number beyond the limits, here or below")

    def _node(self, event: Any, path: Path, depth: int) -> Any:
        """Build one value; the parser has given its first event."""
        self.nodes += 1
        if self.nodes > MAX_NODES:
            self._stop(event, f"more than {MAX_NODES} values: is it an experiment file?")
        if isinstance(event, yaml.AliasEvent):
            return self._fault(event, path, f"aliases (*{str(event.anchor)[:40]}) are not taken: write the value out")
        if event.anchor is not None:
            self._fault(
                event,
                path,
                f"anchors (&{str(event.anchor)[:40]}) are not taken: remove it and write values out",
            )
        if event.tag is not None:
            fault = self._fault(event, path, f"tags ({event.tag[:40]}) are not taken: remove it")
            if isinstance(event, yaml.ScalarEvent):
                return fault
        if isinstance(event, yaml.ScalarEvent):
            return self._scalar(event, path)
        if depth >= MAX_DEPTH:
            self._stop(event, f"values are nested deeper than {MAX_DEPTH} levels")
        if isinstance(event, yaml.SequenceStartEvent):
            return self._sequence(path, depth)
        return self._mapping(path, depth)

    def _scalar(self, event: yaml.ScalarEvent, path: Path) -> Any:
        if event.implicit[0]:
            try:
                return resolve(event.value)
            except ScalarError as error:
                return self._fault(event, path, str(error))
        if _UNFIT_CHARACTER.search(event.value):
            return self._fault(event, path, "the text holds a control character: remove it")
        return event.value

    def _sequence(self, path: Path, depth: int) -> list[Any]:
        out: list[Any] = []
        while not isinstance(event := next(self.events), yaml.SequenceEndEvent):
            here = (*path, len(out))
            self.document.places[here] = Place(_mark(event), _mark(event))
            out.append(self._node(event, here, depth + 1))
        return out

    def _mapping(self, path: Path, depth: int) -> dict[str, Any]:
        out: dict[str, Any] = {}
        while not isinstance(event := next(self.events), yaml.MappingEndEvent):
            key = self._key(event, path)
            here = (*path, key)
            value_event = next(self.events)
            if key in out:
                line = self.document.places[here].key[0]
                self._fault(event, here, f"is already set on line {line}: keep one of the two")
                kept = {p: place for p, place in self.document.places.items() if p[: len(here)] == here}
                self._node(value_event, here, depth + 1)
                self.document.places.update(kept)
                continue
            self.document.places[here] = Place(_mark(event), _mark(value_event))
            out[key] = self._node(value_event, here, depth + 1)
        return out

    def _key(self, event: Any, path: Path) -> str:
        """Read a key as the text that it is: ``1`` and ``1.0`` are two names."""
        self.nodes += 1
        plain = isinstance(event, yaml.ScalarEvent) and event.tag is None and event.anchor is None
        if not plain or not event.value or _UNFIT_CHARACTER.search(event.value):
            self._stop(event, "a key must be plain text, without tag, anchor or alias")
        if event.value == "<<" and event.implicit[0]:
            self._stop(event, "merge keys (<<) are not taken: write the settings out")
        return str(event.value)

    def _fault(self, event: Any, path: Path, message: str) -> Fault:
        """Note a problem that leaves the rest of the text readable."""
        if len(self.document.problems) >= _MAX_PROBLEMS:
            self._stop(event, "too many problems: the rest of the file was not read")
        self.document.problems.append(self.document.problem_at(*_mark(event), message, path))
        return Fault()

    def _stop(self, event: Any, message: str) -> NoReturn:
        self._fail(*_mark(event), message)

    def _fail(self, line: int, column: int, message: str) -> NoReturn:
        """Give up on the text, with all that was found so far."""
        last = self.document.problem_at(line, column, message)
        raise ConfigError(self.document.file, [*self.document.problems, last])


def _mark(event: Any) -> tuple[int, int]:
    return event.start_mark.line + 1, event.start_mark.column + 1


def _plain_words(problem: str) -> str:
    """Say in plain words what PyYAML found."""
    for theirs, ours in _SYNTAX.items():
        if theirs in problem:
            return ours
    return problem

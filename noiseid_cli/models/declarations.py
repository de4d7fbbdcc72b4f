"""What a model declares besides its equations: quantities and parameters, and the checks on their names."""

from __future__ import annotations

import difflib
import keyword
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from noiseid_cli.errors import ModelError


@dataclass(frozen=True)
class Quantity:
    """A state, input, noise or output.

    Attributes:
        name: a Python identifier; the name used in equations, configs and files.
        unit: its unit, such as ``rad/s``; ``1`` or empty for a pure number.
        description: what it is, in a few words.
    """

    name: str
    unit: str = ""
    description: str = ""


@dataclass(frozen=True)
class Parameter:
    """A constant of the equations.

    Attributes:
        name: a Python identifier.
        value: its default value, in ``unit``.
        unit: its unit.
        description: what it is, in a few words.
        source: where the value is from: ``paper`` (printed there), ``read`` (restored from a damaged print),
            ``chosen`` (printed nowhere: chosen for this project), or free text.
    """

    name: str
    value: float
    unit: str = ""
    description: str = ""
    source: str = ""


class Symbols:
    """One vector of a model as sympy symbols: ``x.q1``, ``x["q1"]``, ``x[0]``, or iterated over."""

    def __init__(self, vector: str, names: Iterable[str]) -> None:
        """Make one real symbol for each name; ``vector`` is the letter used in error texts."""
        self._vector = vector
        self._symbols = {name: symbol(name) for name in names}

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        if name not in self._symbols:
            raise ModelError(unknown_name(f"{self._vector}.{name}", name, self._symbols))
        return self._symbols[name]

    def __getitem__(self, key: int | str) -> Any:
        return getattr(self, key) if isinstance(key, str) else tuple(self._symbols.values())[key]

    def __iter__(self) -> Iterator[Any]:
        return iter(self._symbols.values())

    def __len__(self) -> int:
        return len(self._symbols)


class Terms:
    """Named intermediate quantities: ``t.J11 = ...`` defines one, ``t.J11`` read later is its symbol.

    ``t["J11"]`` does the same. A term may use states, inputs, parameters and the terms above it. Equations built
    on the symbols are shown with the terms as definitions, and compiled with each term computed once.
    """

    _definitions: dict[str, Any]

    def __init__(self) -> None:
        """Start without terms."""
        object.__setattr__(self, "_definitions", {})

    def __setattr__(self, name: str, expression: Any) -> None:
        if name in self._definitions:
            raise ModelError(f"term {name} is defined twice; give the second one another name.")
        self._definitions[name] = expression

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        if name not in self._definitions:
            raise ModelError(unknown_name(f"term {name}", name, self._definitions))
        return symbol(name)

    __setitem__ = __setattr__
    __getitem__ = __getattr__

    def definitions(self) -> dict[str, Any]:
        """Expression of each term, in the order of definition."""
        return dict(self._definitions)


def symbol(name: str) -> Any:
    """The sympy symbol that stands for a declared name."""
    import sympy as sp

    return sp.Symbol(name, real=True)


def unknown_name(what: str, name: str, known: Iterable[str]) -> str:
    """Sentence that says that a name is not known, with the nearest or all known ones."""
    known = list(known)
    near = difflib.get_close_matches(name, known, n=1)
    if near:
        return f"{what} is not known; did you mean {near[0]}?"
    return f"{what} is not known; known: {', '.join(known) if known else 'none'}."


def check_declarations(model: Any) -> None:
    """Raise ModelError if a model's declared names, units or numbers cannot be used.

    Args:
        model: instance of ``Model``.
    """
    where = type(model).__name__
    if not isinstance(model.name, str) or not model.name:
        raise ModelError(f'{where}: give the model a name, such as name = "my_robot".')
    for group in ("states", "inputs", "noises", "outputs", "performances", "parameters"):
        _check_group(where, group, getattr(model, group), Parameter if group == "parameters" else Quantity)
    for group in ("states", "noises", "outputs"):
        if not getattr(model, group):
            raise ModelError(f"{where}: {group} is empty; a model has at least one of them.")
    _check_unique(where, model)
    for p in model.parameters:
        check_number(f"{where}: default of parameter {p.name}", p.value)
    check_number(f"{where}: sample_time", model.sample_time)
    if model.sample_time <= 0:
        raise ModelError(f"{where}: sample_time is {model.sample_time} s; it must be above zero.")
    _check_sample_time_parameter(where, model)


def _check_sample_time_parameter(where: str, model: Any) -> None:
    name, defaults = model.sample_time_parameter, {p.name: p.value for p in model.parameters}
    if name and name not in defaults:
        raise ModelError(unknown_name(f"{where}: sample_time_parameter {name}", name, defaults))
    if name and defaults[name] != model.sample_time:
        raise ModelError(
            f"{where}: parameter {name} equals the sample time: give both the same default, "
            f"not {defaults[name]} and {model.sample_time} s."
        )


def _check_group(where: str, group: str, items: Any, kind: type) -> None:
    if not isinstance(items, tuple | list):
        raise ModelError(
            f"{where}: {group} must be a tuple of {kind.__name__}; "
            f"write ({kind.__name__}(...),) with a comma for a single one."
        )
    for item in items:
        if not isinstance(item, kind):
            raise ModelError(f"{where}: {group} holds {item!r}; it must hold {kind.__name__}(...) only.")
        name: Any = item.name  # type: ignore[attr-defined]
        if not isinstance(name, str) or not name.isidentifier() or keyword.iskeyword(name) or name[0] == "_":
            raise ModelError(
                f"{where}: {group}: {name!r} cannot be a name; use letters, digits and underscores, "
                "beginning with a letter, and no word of the Python language."
            )


def _check_unique(where: str, model: Any) -> None:
    symbols = [*model.states, *model.inputs, *model.noises, *model.parameters]
    for items in (symbols, model.outputs, model.performances):
        names = [item.name for item in items]
        doubles = sorted({n for n in names if names.count(n) > 1})
        if doubles:
            raise ModelError(f"{where}: declared twice: {', '.join(doubles)}.")
    units: dict[str, str] = {}
    for item in [*model.states, *model.inputs, *model.noises, *model.outputs, *model.performances]:
        if units.setdefault(item.name, item.unit) != item.unit:
            raise ModelError(
                f"{where}: {item.name} has the unit {units[item.name]!r} in one place and {item.unit!r} in "
                "another; rename one of them."
            )


def check_number(what: str, value: Any) -> None:
    """Raise ModelError unless a value is a finite number."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    # A whole number may have more digits than any float.
    if not number or not abs(value) <= sys.float_info.max:
        large = isinstance(value, int) and value.bit_length() > 64  # Python writes no number of thousands of digits
        shown = "a whole number of too many digits" if large else repr(value)
        raise ModelError(f"{what} is {shown}; it must be a finite number.")

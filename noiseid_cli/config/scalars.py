"""What an unquoted word of an experiment file means: the core rules of YAML 1.2, minus the traps."""

from __future__ import annotations

import math
import re

Scalar = str | int | float | bool | None

_WORDS: dict[str, Scalar] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL"), None),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), math.nan),
    **dict.fromkeys((".inf", ".Inf", ".INF", "+.inf", "+.Inf", "+.INF"), math.inf),
    **dict.fromkeys(("-.inf", "-.Inf", "-.INF"), -math.inf),
}
_INTEGER = re.compile(r"[-+]?[0-9]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_LEADING_ZERO = re.compile(r"[-+]?0[0-9]")
_OTHER_BASE = re.compile(r"[-+]?0[xXoObB][0-9a-fA-F]+")
_LONGEST_INTEGER = 19
_LONGEST_NUMBER = 400


class ScalarError(ValueError):
    """An unquoted word that could be taken for two different things, or for a number that cannot be kept."""


def resolve(text: str) -> Scalar:
    """Give the value of an unquoted scalar.

    ``1e-3`` is a number; ``no``, ``on`` and dates are text; so are ``1_000`` and ``1:30``, which a numeric
    setting then refuses.

    Raises:
        ScalarError: for ``010`` and ``0x1F`` (two readings), for whole numbers of more than 19 digits and for
            numbers that overflow or vanish in double precision.
    """
    if text in _WORDS:
        return _WORDS[text]
    if _OTHER_BASE.fullmatch(text):
        raise ScalarError(f"{text[:40]} is not a decimal number: write it in decimal, or in quotes if it is text")
    if not _FLOAT.fullmatch(text):
        return text
    if len(text) > _LONGEST_NUMBER and not _INTEGER.fullmatch(text):
        raise ScalarError(f"a number of {len(text)} characters: at most {_LONGEST_NUMBER} are allowed")
    if _LEADING_ZERO.match(text):
        raise ScalarError(f"{text[:40]} starts with a needless zero: drop it, or write quotes if it is text")
    return _integer(text) if _INTEGER.fullmatch(text) else _float(text)


def _integer(text: str) -> int:
    digits = len(text.lstrip("+-"))
    if digits > _LONGEST_INTEGER:
        allowed = f"at most {_LONGEST_INTEGER} are allowed; a large number is written like 1.5e{digits - 1}"
        raise ScalarError(f"a whole number of {digits} digits: {allowed}")
    return int(text)


def _float(text: str) -> float:
    value = float(text)
    if math.isinf(value):
        raise ScalarError(f"{text} is larger than the largest number that can be kept, 1.8e308")
    if value == 0.0 and re.search("[1-9]", re.split("[eE]", text)[0]):
        raise ScalarError(f"{text} is smaller than the smallest number that can be kept, 4.9e-324")
    return value

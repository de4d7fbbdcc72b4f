"""What a compiled function is made of, as a hash: the copy on the disk is good as long as this stays.

numba looks at the time stamp of the one file in which a function stands. It does not see a change of a routine that the
function calls from another file, and takes an unchanged file with another time stamp for a change.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from types import CodeType, ModuleType
from typing import Any


def stamp_of(function: Any) -> str:
    """Hash over the bytecode, the constants and the options of a compiled function and of all that it calls.

    Names of modules count, what stands in them does not: numba, numpy and math have versions of their own.
    """
    digest = hashlib.sha256()
    for part in _parts(function, set()):
        digest.update(f"{part!r}\n".encode())
    return digest.hexdigest()


def _parts(value: Any, seen: set[int]) -> Iterator[Any]:
    """All that a function, or a value that a function reads, is made of."""
    inner = getattr(value, "py_func", None) or getattr(value, "__wrapped__", None) or value  # of numba's wrappers
    code = getattr(inner, "__code__", None)
    if code is not None:
        if id(code) not in seen:
            seen.add(id(code))
            yield sorted((k, repr(v)) for k, v in getattr(value, "targetoptions", {}).items())
            yield from _code_parts(code, inner.__globals__, seen)
    elif isinstance(value, ModuleType):
        yield value.__name__
    elif isinstance(value, tuple):
        for item in value:
            yield from _parts(item, seen)
    elif isinstance(value, (bool, int, float, complex, str, bytes)):
        yield value
    elif hasattr(value, "tobytes"):
        yield str(value.dtype), value.shape, value.tobytes()
    else:  # a class, such as a tuple of scratch arrays, is what its fields are; an address says nothing
        yield type(value).__qualname__, getattr(value, "_fields", None)


def _code_parts(code: CodeType, known: Mapping[str, Any], seen: set[int]) -> Iterator[Any]:
    yield code.co_code, code.co_names, code.co_varnames
    for place, constant in enumerate(code.co_consts):
        if isinstance(constant, CodeType):
            yield from _code_parts(constant, known, seen)
        elif isinstance(constant, frozenset):
            yield sorted(map(repr, constant))
        elif place > 0 or not isinstance(constant, (str, type(None))):  # the first is the docstring, or none
            yield constant
    for name in code.co_names:
        if name in known:
            yield name
            yield from _parts(known[name], seen)

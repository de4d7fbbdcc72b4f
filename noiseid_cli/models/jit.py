"""How every compiled function of noiseid is compiled, in one place.

No fastmath flag that assumes finite values is used anywhere: NaN is data here.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from noiseid_cli.models.cache import place_kernels

place_kernels(Path(__file__).parents[1])

from numba import njit  # noqa: E402 - it reads where to keep its cache when it is imported

Function = Callable[..., Any]


def kernel(signature: Any) -> Callable[[Function], Function]:
    """Compile an entry point for one signature; kept in the on-disk cache, runs without the interpreter lock.

    It is compiled, or read from the cache, when it is first called: a run pays for the kernels that it uses only.
    """

    def declare(function: Function) -> Function:
        compiled: Any = njit(cache=True, nogil=True, error_model="numpy")(function)

        def ready(*_: Any) -> Any:
            compiled.compile(signature)
            compiled.disable_compile()
            vars(compiled).pop("_compile_for_args", None)  # another thread may have been here first
            return compiled

        # What numba's dispatcher asks for something to call where no version fits the arguments: there is none yet.
        compiled._compile_for_args = ready
        return compiled  # type: ignore[no-any-return]

    return declare


def equation(signature: Any) -> Callable[[Function], Function]:
    """Compile a function of a model, at once: kernels take it as a value, for which it must be there."""
    compiled: Callable[[Function], Function] = njit(signature, cache=True, error_model="numpy")
    return compiled


def routine(function: Function) -> Function:
    """Compile a subroutine of kernels for whatever it is called with."""
    compiled: Function = njit(error_model="numpy")(function)
    return compiled

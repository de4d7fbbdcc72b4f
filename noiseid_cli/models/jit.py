"""How every compiled function of noiseid is compiled, in one place.

No fastmath flag that assumes finite values is used anywhere: NaN is data here.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from noiseid_cli.models.cache import place_kernels
from noiseid_cli.models.stamp import stamp_of

place_kernels(Path(__file__).parents[1])

from numba import njit as _njit  # noqa: E402 - it reads where to keep its cache when it is imported

Function = Callable[..., Any]

njit: Any = _njit
"""Its stubs do not know ``_nrt``, which says whether references to arrays are counted."""


def kernel(signature: Any, allocates: bool = False) -> Callable[[Function], Function]:
    """Compile an entry point for one signature; kept in the on-disk cache, runs without the interpreter lock.

    It is compiled, or read from the cache, when it is first called: a run pays for the kernels that it uses only.

    Args:
        signature: of the compiled function.
        allocates: whether it makes arrays, or takes a record of ``models.handle``. Then numba counts references
            to each array and to each view of one, by atomic operations that stop the processor's pipeline. A kernel
            that loops over samples should therefore make its scratch arrays and leave the loop to a routine.
    """

    def declare(function: Function) -> Function:
        compiled: Any = njit(cache=True, nogil=True, error_model="numpy", _nrt=allocates)(function)

        def ready(*_: Any) -> Any:
            _compile(compiled, signature)
            vars(compiled).pop("_compile_for_args", None)  # another thread may have been here first
            return compiled

        # What numba's dispatcher asks for something to call where no version fits the arguments: there is none yet.
        compiled._compile_for_args = ready
        return compiled  # type: ignore[no-any-return]

    return declare


def equation(signature: Any) -> Callable[[Function], Function]:
    """Compile a function of a model, at once: kernels take it as a value, for which it must be there."""

    def declare(function: Function) -> Function:
        compiled: Any = njit(cache=True, error_model="numpy")(function)
        _compile(compiled, signature)
        # numba looks for the one version and its addresses whenever a kernel is called with the function: 25 us each.
        (made,) = compiled.overloads.values()
        made.library.get_pointer_to_function = cache(made.library.get_pointer_to_function)
        compiled.get_compile_result = lambda _: made
        return compiled  # type: ignore[no-any-return]

    return declare


def _compile(compiled: Any, signature: Any) -> None:
    """Compile a function, or read it from the cache if nothing that it is made of has changed."""
    compiled._cache._cache_file._source_stamp = stamp_of(compiled)
    compiled.compile(signature)
    compiled.disable_compile()


def routine(function: Function) -> Function:
    """Compile a subroutine of kernels into each place that calls it; it can make no arrays, see ``kernel``.

    A call that is not put in place hands over nine numbers of each array, which takes as long as a small product.
    """
    compiled: Function = njit(error_model="numpy", _nrt=False, forceinline=True)(function)
    return compiled


def allocating(function: Function) -> Function:
    """Compile a subroutine that makes arrays or takes a record of ``models.handle``, for kernels that do."""
    compiled: Function = njit(error_model="numpy", _nrt=True, forceinline=True)(function)
    return compiled

"""How every compiled function of noiseid is compiled, in one place.

No fastmath flag that assumes finite values is used anywhere: NaN is data here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit

Function = Callable[..., Any]


def kernel(signature: Any) -> Callable[[Function], Function]:
    """Compile an entry point for one signature; kept in the on-disk cache, runs without the interpreter lock."""
    compiled: Callable[[Function], Function] = njit(signature, cache=True, nogil=True, error_model="numpy")
    return compiled


def routine(function: Function) -> Function:
    """Compile a subroutine of kernels for whatever it is called with."""
    compiled: Function = njit(error_model="numpy")(function)
    return compiled

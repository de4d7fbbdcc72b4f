"""Says when the numerical kernels are compiled: once on a machine, and long enough to wonder."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

SENTENCE = "Compiling numerical kernels: up to a minute, once on this machine."


@contextmanager
def kernels_announced(say: Callable[[str], None]) -> Iterator[None]:
    """Say so if numba compiles one of our kernels meanwhile; it tells of each that its cache does not hold."""
    from numba.core import event

    class Compilation(event.Listener):
        def on_start(self, event: Any) -> None:
            compiled = event.data["dispatcher"]
            # Those without a cache are small parts of others; a model's equations are told of by ``models.compile``.
            if compiled.stats.cache_path is not None and compiled.py_func.__module__.startswith("noiseid_cli."):
                say(SENTENCE)

        def on_end(self, event: Any) -> None:
            pass

    with event.install_listener("numba:compile", Compilation()):
        yield

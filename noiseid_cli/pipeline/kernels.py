"""When the numerical kernels are compiled: once on a machine, and long enough to wonder."""

from __future__ import annotations

import hashlib
import platform
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from noiseid_cli.pipeline.context import Context
    from noiseid_cli.pipeline.unit import DatasetUnit, EstimateUnit

SENTENCE = "Compiling numerical kernels: up to a minute, once on this machine."


@contextmanager
def kernels_announced(say: Callable[[str], None], compiling: Callable[[int, str], None]) -> Iterator[None]:
    """Tell if numba compiles our kernels meanwhile; it tells of each that its cache does not hold.

    Args:
        say: gets a sentence before the first one, and one at the end: how many there were and how long it took.
        compiling: gets the number and the name of each, such as ``3, ekf.run_filter``, before it is compiled.
    """
    from numba.core import event

    from noiseid_cli.models.cache import unkept

    class Compilation(event.Listener):
        count, seconds = 0, 0.0

        def on_start(self, event: Any) -> None:
            if not _is_kernel(event.data["dispatcher"]):
                return
            if not self.count:
                say(SENTENCE)
            self.count += 1
            function = event.data["dispatcher"].py_func
            compiling(self.count, f"{function.__module__.rpartition('.')[2]}.{function.__name__}")
            self.began = time.monotonic()

        def on_end(self, event: Any) -> None:
            if _is_kernel(event.data["dispatcher"]):
                self.seconds += time.monotonic() - self.began

    heard = Compilation()
    with event.install_listener("numba:compile", heard):
        yield
    if heard.count:
        kernels = "1 kernel" if heard.count == 1 else f"{heard.count} kernels"
        say(f"{kernels} compiled in {heard.seconds:.0f} s{'' if unkept() else ', and kept'}.")
    if unkept():
        say(unkept())


def _is_kernel(compiled: Any) -> bool:
    """Not a small part of others, which has no cache, nor a model's equations, of which ``models.compile`` tells."""
    return compiled.stats.cache_path is not None and compiled.py_func.__module__.startswith("noiseid_cli.")


class Compiled:
    """Whether units like these were made on this machine before, so that their kernels lie compiled in the cache.

    An empty file in the cache folder says so, named by all that decides: sources, versions, the model's equations, the
    methods. Where it is wrong (somebody has emptied numba's own cache) every worker compiles; nothing else.
    """

    def __init__(self, context: Context, units: Sequence[DatasetUnit | EstimateUnit]) -> None:
        """Look for the file."""
        from noiseid_cli.models.cache import cache_root

        methods = sorted({getattr(unit, "options", None).__class__.__name__ for unit in units})
        text = "\n".join([context.model_digest, *methods, *_sources(), sys.version, platform.processor()])
        self._file = cache_root() / "compiled" / hashlib.sha256(text.encode()).hexdigest()[:32]

    @property
    def known(self) -> bool:
        """They were made before."""
        return self._file.exists()

    def note(self) -> None:
        """One of them is made now."""
        with suppress(OSError):  # a cache that cannot be written is told of elsewhere
            if not self.known:
                self._file.parent.mkdir(parents=True, exist_ok=True)
                self._file.touch()


def _sources() -> list[str]:
    """Name, size and time of every source that holds kernels, by which numba's cache goes too."""
    import numba

    package = Path(__file__).parents[1]
    rooms = ("models", "filters", "estimators", "simulation", "diagnostics")
    stats = [(path, path.stat()) for room in rooms for path in sorted((package / room).rglob("*.py"))]
    return [numba.__version__, str(package), *(f"{path.name} {s.st_size} {s.st_mtime_ns}" for path, s in stats)]

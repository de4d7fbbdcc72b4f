"""Work on several tests at once: compiled kernels run without the interpreter lock.

Each item's result depends on that item alone and results come in order, so that the numbers are the same bits for any
number of threads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

# Threads do not inherit it: what runs in one starts no others.
_AT_ONCE: ContextVar[int] = ContextVar("threads", default=1)


@contextmanager
def use_threads(count: int) -> Iterator[None]:
    """Work on up to ``count`` tests at once within this block; on one at a time elsewhere."""
    token = _AT_ONCE.set(max(1, count))
    try:
        yield
    finally:
        _AT_ONCE.reset(token)


def in_threads(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """``[function(item) for item in items]``, several at once; the first error in their order is raised."""
    from concurrent.futures import ThreadPoolExecutor

    items = list(items)
    workers = min(_AT_ONCE.get(), len(items))
    if workers < 2:
        return [function(item) for item in items]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(function, items))

"""Units on a dask cluster: a unit writes its own file on the worker, and only its token travels.

So the scheduler holds nothing worth keeping. Workers may die, join late and be many: what has its file is done, a unit
whose worker died goes to another one, and two workers that make the same unit leave the same file. Workers and this
process must see the same folders under the same names, and run the same noiseid.
"""

from __future__ import annotations

import logging
import re
import threading
import traceback
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from noiseid_cli.errors import DataError, MachineError, NoiseidError, machine_error
from noiseid_cli.pipeline.context import Context
from noiseid_cli.pipeline.making import Listener, Token, Unit, make
from noiseid_cli.pipeline.unit import DatasetUnit
from noiseid_cli.pipeline.workers import TRIES, Recipe, WorkerError, recipe_of

if TYPE_CHECKING:
    from distributed import Client, Future, LocalCluster

LOCAL = "local"
_LOOPBACK = ("127.0.0.1", "localhost", "::1")
_PATIENCE = 10.0  # s until a scheduler that does not answer counts as not there
_MOMENT = 1.0  # s that one question to the scheduler may hold up the others
_LOST = (
    "the connection to the dask scheduler was lost; what is finished is kept, and the same command goes on from there"
)
_STILLBORN = (
    "the workers of --dask local died {} times while they started (killed for want of memory?): run the same command "
    "again, with fewer --jobs if memory is short"
)
_KILLED = "its worker died {} times (killed for want of memory?): run the same command again, on larger workers"


def on_cluster(
    context: Context, units: Sequence[Unit], listener: Listener, address: str, workers: int
) -> Generator[Token]:
    """Make units on a dask cluster; tokens come in the order in which the units end.

    Args:
        context: the opened experiment; each worker opens it again.
        units: what to make.
        listener: is told what goes on.
        address: of the scheduler, such as ``tcp://127.0.0.1:8786``, or its file, or ``local`` for one of our own.
        workers: number of workers, for ``local``.

    Raises:
        MachineError: the disk of a worker is full or faulty, or the scheduler is lost.
        DataError: there is no scheduler at the address, or its workers cannot run noiseid.
        WorkerError: a bug showed in a worker.
    """
    recipe = recipe_of(context)
    with ExitStack() as stack:
        client = _connect(address, workers, stack, listener)
        waiting, pending = deque(units), dict[Any, Unit]()
        stack.callback(_drop, client, pending)
        while waiting or pending:
            # As many as can run: a unit that waits at a worker would be counted when that worker dies.
            room = max(1, sum(_threads(client).values()))
            while waiting and len(pending) < room:
                unit = waiting.popleft()
                pending[client.submit(work, recipe, _absolute(unit), pure=False)] = unit
                listener.begin(unit.name)
            for future in _ended(client, pending):
                unit = pending[future]
                with _losses_told():
                    token = _token(future, unit)
                if token:
                    del pending[future]
                    yield replace(token, unit=unit.name, path=unit.path)


def work(recipe: Recipe, unit: Unit) -> Token | MachineError | str:
    """What a worker does: make one unit, tell how it ended; a bug is told as the text of its traceback."""
    try:
        with _opening:
            context = _opened.get(recipe)
            if context is None:
                context = _opened[recipe] = recipe.open(lambda _: None)
        return make(context, unit, Listener())  # which does not listen: the token tells all
    except Exception as error:
        if fault := machine_error(error):
            return fault
        if isinstance(error, NoiseidError):
            return Token(unit.name, unit.path, "failed", str(error))
        return traceback.format_exc()


_opening = threading.Lock()
_opened: dict[Recipe, Context] = {}


def check_address(address: str) -> None:
    """Refuse what cannot be a scheduler's address.

    Raises:
        DataError: it is neither ``local``, a file, nor of the form ``tcp://HOST:PORT``.
    """
    known = address == LOCAL or Path(address).is_file() or re.fullmatch(r"(tcp|tls|ws|wss|ucx)://[^\s/]+:\d+", address)
    if not known:
        raise DataError(
            f"--dask {address!r}: give the address of a dask scheduler, such as tls://node1:8786 or "
            "tcp://127.0.0.1:8786, or its scheduler file, or local"
        )


def _connect(address: str, workers: int, stack: ExitStack, listener: Listener) -> Client:
    """A client of the scheduler; closed with the stack."""
    check_address(address)
    try:
        import dask
        from distributed import Client
    except ImportError as error:
        raise DataError("--dask needs dask.distributed: pip install 'noiseid[cluster]'") from error
    _hush()
    target: Any = address
    if address == LOCAL:
        stack.enter_context(
            dask.config.set(
                {"distributed.scheduler.allowed-failures": TRIES - 1, "distributed.scheduler.worker-saturation": 1.0}
            )
        )
        target = stack.enter_context(_cluster_here(workers))
    elif urlsplit(address).scheme == "tcp" and urlsplit(address).hostname not in _LOOPBACK:
        listener.say(
            "dask's tcp:// is neither encrypted nor authenticated: anybody who reaches the scheduler can run code "
            "on its workers. Use tls:// on a network that you do not trust."
        )
    try:
        if Path(address).is_file():
            client = Client(scheduler_file=address, timeout=_PATIENCE)
        else:
            client = Client(target, timeout=_PATIENCE)
    except (OSError, ValueError) as error:
        raise DataError(f"no dask scheduler answers at {address}: {error}; is it running?") from error
    stack.callback(client.close, timeout=1.0)
    if not _threads(client):
        listener.say(f"Waiting for workers of the dask scheduler at {address}.")
    return client


def _cluster_here(workers: int) -> LocalCluster:
    """A scheduler and workers on this machine only: the page of their state too."""
    from distributed import LocalCluster

    place = {"host": _LOOPBACK[0], "dashboard_address": f"{_LOOPBACK[0]}:0"}
    for attempt in range(1, TRIES + 1):
        try:
            return LocalCluster(n_workers=workers, threads_per_worker=1, silence_logs=50, **place)
        except RuntimeError as error:  # a worker died before it was at work
            if attempt == TRIES:
                raise MachineError(_STILLBORN.format(TRIES)) from error
    raise AssertionError


def _threads(client: Client) -> dict[str, int]:
    """Number of threads of each worker that is there now."""
    with _losses_told():
        return dict(client.nthreads())


def _ended(client: Client, pending: dict[Any, Unit]) -> list[Any]:
    """The futures that have ended, within a second or so; new workers are looked for meanwhile."""
    from distributed import wait

    with _losses_told(), suppress(TimeoutError):
        wait(list(pending), timeout=_MOMENT, return_when="FIRST_COMPLETED")
    if client.status != "running":
        raise MachineError(_LOST)
    return [future for future in pending if future.done()]  # not those that wait, nor those lost with their worker


def _token(future: Future[Any], unit: Unit) -> Token | None:
    """How a unit ended, from its future; None if what it told was lost with its worker, so that it is made again."""
    from distributed import KilledWorker

    if future.status == "finished":
        try:
            told = future.result(timeout=_MOMENT)
        except TimeoutError:
            return None
        if isinstance(told, MachineError):
            raise told
        if isinstance(told, str):
            raise WorkerError(told)
        token: Token = told
        return token
    if future.status == "error":
        error = future.exception(timeout=_PATIENCE)
        if isinstance(error, KilledWorker):
            tries = error.allowed_failures + 1
            return Token(unit.name, unit.path, "failed", _KILLED.format(tries), tries=tries)
        raise DataError(f"the workers cannot run noiseid: {type(error).__name__}: {error}") from error
    raise MachineError(_LOST)


@contextmanager
def _losses_told() -> Iterator[None]:
    """Whatever dask raises when its scheduler has gone, in a sentence."""
    from distributed import CancelledError

    try:
        yield
    except (OSError, ValueError, CancelledError) as error:
        raise MachineError(_LOST) from error


def _hush() -> None:
    """Keep off the screen the tracebacks that dask logs when a connection breaks: what they mean is said in words."""
    for name in ("distributed.client", "distributed.core", "distributed.comm", "tornado.application", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)


def _absolute(unit: Unit) -> Unit:
    """The unit with paths that a worker understands, wherever it was started."""
    path = unit.path.absolute()
    if isinstance(unit, DatasetUnit):
        return replace(unit, path=path)
    held_out = unit.held_out and replace(unit.held_out, path=unit.held_out.path.absolute())
    return replace(unit, path=path, dataset=replace(unit.dataset, path=unit.dataset.path.absolute()), held_out=held_out)


def _drop(client: Client, pending: dict[Any, Unit]) -> None:
    """Give up what has not ended."""
    if pending:
        with suppress(Exception):  # the scheduler may be gone: there is nothing left to give up then
            client.cancel(list(pending), force=True)

"""Worker processes: each is handed one unit at a time through a pipe, and tells through it what goes on.

A worker that dies (for want of memory, say) puts off its unit only; a unit at which three workers died is given up. An
interrupt is the parent's affair: workers never see Ctrl-C, and are ended by the parent at once. If the parent itself is
killed, they notice at their next word. A worker that is at one unit for longer than the time limit is ended with it.

Where the kernels are not compiled yet, the first worker goes ahead, so that not every one of them compiles: until it
has made a unit, or has passed over the data twice, for which it has compiled nearly all.
"""

from __future__ import annotations

import multiprocessing
import signal
import time
import traceback
from collections import Counter, deque
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing import connection, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from noiseid_cli.errors import DataError, MachineError, NoiseidError, machine_error
from noiseid_cli.models.threads import use_threads
from noiseid_cli.pipeline.context import Context, Say, open_experiment
from noiseid_cli.pipeline.kernels import Compiled
from noiseid_cli.pipeline.making import Listener, Token, Unit, make

TRIES = 3
"""So many workers may die at a unit before it is given up."""

_DIED = (
    "its worker process died {} times, the last time with exit code {} (killed for want of memory?): "
    "run the same command again, with fewer --jobs if memory is short"
)


_LATE = "it was ended after {:g} s, the limit of --unit-timeout: find out why it hangs or takes so long, or allow more"
_AHEAD = 120.0
"""s that the first worker may go ahead at most, where kernels are to be compiled."""


class WorkerError(Exception):
    """A bug showed in a worker process; the text is its traceback."""


@dataclass(frozen=True)
class Recipe:
    """What a worker needs to open the experiment again, and to see that it is still the same."""

    file: Path
    root: Path
    overrides: tuple[str, ...]
    seed: int | None
    fingerprint: str

    def open(self, say: Say) -> Context:
        """Open the experiment.

        Raises:
            NoiseidError: it cannot be opened any more, or it is another one by now.
        """
        context = open_experiment(self.file, self.root, self.overrides, self.seed, say)
        if context.fingerprint != self.fingerprint:
            raise DataError(f"{self.file} or its model was changed while this run started: run the same command again")
        return context


def recipe_of(context: Context) -> Recipe:
    """What a worker needs to open the same experiment, wherever it was started."""
    return Recipe(
        context.loaded.file.absolute(),
        context.root.absolute(),
        context.overrides,
        context.seed,
        context.fingerprint,
    )


class _Teller(Listener):
    """The listener inside a worker: hands on to the parent what it is told."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe

    def stage(self, name: str, total: int, there: int) -> None:
        self._pipe.send(("stage", name, total, there))

    def begin(self, unit: str) -> None:
        self._pipe.send(("begin", unit))

    def compiling(self, unit: str, count: int, kernel: str) -> None:
        self._pipe.send(("compiling", unit, count, kernel))

    def passed(self, unit: str, passes: int, loglik: float) -> None:
        self._pipe.send(("passed", unit, passes, loglik))

    def end(self, token: Token) -> None:
        self._pipe.send(("end", token))

    def say(self, sentence: str) -> None:
        self._pipe.send(("say", sentence))


def _work(recipe: Recipe, pipe: Connection, threads: int) -> None:
    """Life of a worker: take a unit, make it, tell the end."""
    teller = _Teller(pipe)
    context: Context | None = None
    # The pipe breaks when the parent is gone: there is nobody left to work for.
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        while True:
            unit: Unit = pipe.recv()
            try:
                context = context or recipe.open(teller.say)
                with use_threads(threads):
                    token = make(context, unit, teller)
                teller.end(token)
            except (BrokenPipeError, ConnectionResetError):
                raise
            except Exception as error:
                if fault := machine_error(error):
                    pipe.send(("machine", str(fault)))
                elif isinstance(error, NoiseidError):
                    teller.end(Token(unit.name, unit.path, "failed", str(error)))
                else:  # a bug: the parent reports it
                    pipe.send(("bug", traceback.format_exc()))


@dataclass
class _Worker:
    """A worker as the parent sees it."""

    process: BaseProcess
    pipe: Connection
    unit: Unit
    since: float = field(default_factory=time.monotonic)
    compiled: bool = False


def in_processes(
    context: Context,
    units: Sequence[Unit],
    listener: Listener,
    workers: int,
    time_limit: float | None = None,
    threads: int = 1,
) -> Generator[Token]:
    """Make units in worker processes; tokens come in the order in which the units end.

    Closing this generator ends the workers at once.

    Args:
        context: the opened experiment; each worker opens it again.
        units: what to make.
        listener: is told what goes on.
        workers: number of processes.
        time_limit: longest time from the hand-over of a unit to its end, s; None: no limit.
        threads: so many tests of a unit may be worked on at once, in each.

    Raises:
        MachineError: the disk is full or faulty.
        WorkerError: a bug showed in a worker.
    """
    recipe, compiled = recipe_of(context), Compiled(context, units)
    waiting = deque(units)
    deaths: Counter[str] = Counter()
    crew: list[_Worker] = []
    alone_until = 0.0 if compiled.known or workers == 1 else time.monotonic() + _AHEAD
    try:
        while waiting or crew:
            room = 1 if time.monotonic() < alone_until else workers
            while waiting and len(crew) < room:
                crew.append(_hire(recipe, waiting.popleft(), threads))
            due = [alone_until] if room < workers else []
            due += [worker.since + time_limit for worker in crew] if time_limit is not None else []
            patience = max(0.0, min(due) - time.monotonic()) if due else None
            ready: list[Any] = connection.wait([worker.pipe for worker in crew], patience)
            for worker in list(crew):
                token = None
                if worker.pipe in ready:
                    token = _hear(worker, listener)
                elif time_limit is not None and time.monotonic() >= worker.since + time_limit:
                    token = _end_late(worker, time_limit)
                if worker.pipe.closed:
                    crew.remove(worker)
                    if token is None:
                        deaths[worker.unit.name] += 1
                        token = _bury(worker, deaths[worker.unit.name])
                    if token is None:
                        listener.say(f"{worker.unit.name}: its worker process died; it is tried again.")
                        waiting.append(worker.unit)
                alone_until = 0.0 if worker.compiled else alone_until
                if token is None:
                    continue
                if token.state == "made":
                    compiled.note()
                yield token
                if worker.pipe.closed:
                    continue
                if waiting:
                    _hand_over(worker, waiting.popleft())
                else:
                    crew.remove(worker)
                    _dismiss(worker)
    finally:
        for worker in crew:
            _dismiss(worker)


def _end_late(worker: _Worker, time_limit: float) -> Token:
    """End a worker whose unit takes too long; the unit has failed, and trying it again would take as long."""
    worker.process.kill()  # it may be deaf to anything less
    worker.process.join()
    worker.pipe.close()
    unit = worker.unit
    return Token(unit.name, unit.path, "failed", _LATE.format(time_limit), seconds=time_limit)


def _hear(worker: _Worker, listener: Listener) -> Token | None:
    """One message of a worker; a token if its unit has ended. The pipe of a dead worker is closed."""
    try:
        what, *told = worker.pipe.recv()
    except (EOFError, OSError):
        worker.process.join()
        worker.pipe.close()
        return None
    if what == "machine":
        raise MachineError(told[0])
    if what == "bug":
        raise WorkerError(told[0])
    if what == "end":
        token: Token = told[0]
        worker.compiled |= token.state == "made"
        return token
    worker.compiled |= what == "passed" and told[1] >= 2
    getattr(listener, what)(*told)
    return None


def _bury(worker: _Worker, deaths: int) -> Token | None:
    """The token of a unit at which so many workers have died; None if it is to be tried again."""
    unit = worker.unit
    if deaths < TRIES:
        return None
    message = _DIED.format(deaths, worker.process.exitcode)
    return Token(unit.name, unit.path, "failed", message, tries=deaths)


def _hire(recipe: Recipe, unit: Unit, threads: int) -> _Worker:
    """Start a worker on its first unit."""
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe()
    process = spawn.Process(target=_work, args=(recipe, theirs, threads), daemon=True)
    with _interrupts_blocked():
        process.start()
    theirs.close()
    worker = _Worker(process, ours, unit)
    _hand_over(worker, unit)
    return worker


def _hand_over(worker: _Worker, unit: Unit) -> None:
    worker.unit, worker.since = unit, time.monotonic()
    # A worker that has just died is found out when it is listened to.
    with suppress(BrokenPipeError, ConnectionResetError):
        worker.pipe.send(unit)


def _dismiss(worker: _Worker) -> None:
    worker.process.terminate()
    worker.process.join()
    worker.pipe.close()


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Hold Ctrl-C back: processes started here inherit that, and never see one; this one sees it afterwards."""
    # Python's own helper process unblocks signals when it starts: let that be over before.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)

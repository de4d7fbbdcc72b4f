"""Runs units of work, here or in several processes of this machine.

A unit writes its own file before it returns; what travels back is a short token. So whatever ends a run, the files
that are there are complete, and the next run goes on with the missing ones. The results do not depend on the number of
processes or on the order.
"""

from __future__ import annotations

import multiprocessing
import signal
import time
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from noiseid_cli.errors import EstimationError, NoiseidError
from noiseid_cli.pipeline.context import Context, open_experiment
from noiseid_cli.pipeline.units import DatasetUnit, EstimateUnit

Unit = DatasetUnit | EstimateUnit


@dataclass(frozen=True)
class Token:
    """How one unit ended.

    Attributes:
        unit: its name.
        path: its file.
        state: ``made`` now, ``there`` already, or ``failed`` without a file.
        message: for ``failed``, why; else a short result.
        converged: False for an estimate that did not.
        seconds: wall-clock time.
    """

    unit: str
    path: Path
    state: str
    message: str = ""
    converged: bool = True
    seconds: float = 0.0


class Listener(Protocol):
    """Is told what goes on."""

    def stage(self, name: str, total: int, there: int) -> None:
        """A stage begins, with so many units of which some are there already."""

    def begin(self, unit: str) -> None:
        """A unit begins."""

    def passed(self, unit: str, passes: int, loglik: float) -> None:
        """An estimation unit has passed over its data once more."""

    def end(self, token: Token) -> None:
        """A unit has ended."""

    def say(self, sentence: str) -> None:
        """Something worth a sentence."""


@dataclass(frozen=True)
class Recipe:
    """What a worker process needs to open the experiment again."""

    file: Path
    root: Path
    overrides: tuple[str, ...]
    seed: int | None


def run_units(
    context: Context,
    recipe: Recipe,
    stage: str,
    units: Sequence[Unit],
    listener: Listener,
    jobs: int = 1,
    force: bool = False,
) -> list[Token]:
    """Make every unit that is not there; with ``force``, all of them.

    Args:
        context: the opened experiment.
        recipe: how a worker process opens it.
        stage: name of the stage, for the listener.
        units: what to make, in order.
        listener: is told what goes on.
        jobs: number of processes; 1 works in this one.
        force: make units anew that are there.

    Returns:
        One token per unit, in the order of ``units``.

    Raises:
        NoiseidError: with one unit only: its own error. Among several, an error is a ``failed`` token.
    """
    todo = [u for u in units if force or not u.done]
    listener.stage(stage, len(units), len(units) - len(todo))
    tokens = {u.name: Token(u.name, u.path, "there") for u in units if u not in todo}
    workers = min(jobs, len(todo))
    for token in _here(context, todo, listener) if workers <= 1 else _in_processes(recipe, todo, listener, workers):
        tokens[token.unit] = token
        listener.end(token)
    return [tokens[u.name] for u in units]


def _here(context: Context, units: Sequence[Unit], listener: Listener) -> Any:
    for unit in units:
        listener.begin(unit.name)
        yield _make(context, unit, lambda k, ll, name=unit.name: listener.passed(name, k, ll))


def _make(context: Context, unit: Unit, progress: Any) -> Token:
    """Run one unit; the errors that it raises on purpose become its token."""
    from noiseid_cli.pipeline.datasets import make_dataset
    from noiseid_cli.pipeline.estimation import make_estimate

    began = time.perf_counter()
    try:
        if isinstance(unit, DatasetUnit):
            dataset = make_dataset(context, unit)
            samples = sum(r.samples for r in dataset.recordings)
            message, converged = f"{len(dataset.recordings)} test(s), {samples} samples", True
        else:
            estimate = make_estimate(context, unit, progress).estimate
            message = f"{estimate.status} after {estimate.passes} passes, log-likelihood {estimate.loglik:.2f}"
            converged = estimate.status == "converged"
    except NoiseidError as error:
        return Token(unit.name, unit.path, "failed", str(error), False, time.perf_counter() - began)
    return Token(unit.name, unit.path, "made", message, converged, time.perf_counter() - began)


_worker: dict[str, Any] = {}


def _start_worker(recipe: Recipe, events: Any) -> None:
    """Open the experiment once per process. Ctrl-C is for the parent, which ends its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _worker["events"] = events
    _worker["context"] = open_experiment(recipe.file, recipe.root, recipe.overrides, recipe.seed)


def _work(unit: Unit) -> Token:
    events = _worker["events"]
    events.put((unit.name, 0, 0.0))
    return _make(_worker["context"], unit, lambda k, ll: events.put((unit.name, k, ll)))


def _in_processes(recipe: Recipe, units: Sequence[Unit], listener: Listener, workers: int) -> Any:
    spawn = multiprocessing.get_context("spawn")
    with spawn.Manager() as manager:
        events = manager.Queue()
        pool = ProcessPoolExecutor(workers, spawn, _start_worker, (recipe, events))
        try:
            waiting: set[Future[Token]] = {pool.submit(_work, unit) for unit in units}
            while waiting:
                done, waiting = wait(waiting, timeout=0.1, return_when=FIRST_COMPLETED)
                while not events.empty():
                    name, passes, loglik = events.get()
                    if passes:
                        listener.passed(name, passes, loglik)
                    else:
                        listener.begin(name)
                for future in done:
                    yield future.result()
        except BrokenProcessPool as error:
            raise EstimationError(
                "a worker process was killed (out of memory?); the results so far are kept: run the command again"
            ) from error
        finally:
            pool.shutdown(wait=True, cancel_futures=True)

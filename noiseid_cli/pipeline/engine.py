"""Runs the units of a stage, here, in several processes of this machine, or on a dask cluster.

A unit writes its own file before it returns; what travels back is a short token. So whatever ends a run, the files
that are there are complete, and the next run goes on with the missing ones. The results do not depend on the number of
processes or on the order. A unit that fails is a token too: the others go on, and a record of it stays in its place.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import closing, nullcontext, suppress

from noiseid_cli.errors import DataError
from noiseid_cli.pipeline.cluster import on_cluster
from noiseid_cli.pipeline.context import Context
from noiseid_cli.pipeline.making import Listener, Token, Unit, found, make
from noiseid_cli.pipeline.workers import in_processes


def run_units(
    context: Context,
    stage: str,
    units: Sequence[Unit],
    listener: Listener,
    jobs: int = 1,
    force: bool = False,
    wait: bool = False,
    dask: str = "",
) -> list[Token]:
    """Make every unit that is not there; with ``force``, all of them.

    Args:
        context: the opened experiment.
        stage: name of the stage, for the listener.
        units: what to make, in order.
        listener: is told what goes on.
        jobs: number of processes; 1 works in this one.
        force: make units anew that are there.
        wait: wait for a run that is at work in the same folder.
        dask: address of a dask scheduler that makes them, or ``local``; empty for processes of this machine.

    Returns:
        One token per unit, in the order of ``units``.

    Raises:
        DataError: another run is at work in the same folder.
    """
    from noiseid_cli.storage.lock import locked

    # With nothing to make, a folder may be anybody's, or not be writable at all.
    at_rest = not force and all(unit.done for unit in units)
    with nullcontext() if at_rest else locked(context.folder, listener.say, wait):
        return _run(context, stage, units, listener, jobs, force, dask)


def _run(
    context: Context, stage: str, units: Sequence[Unit], listener: Listener, jobs: int, force: bool, dask: str
) -> list[Token]:
    from noiseid_cli.storage.atomic import sweep_parts

    for folder in {unit.path.parent for unit in units}:
        sweep_parts(folder)
    tokens = {} if force else {unit.name: found(unit) for unit in units if unit.done}
    todo = [unit for unit in units if unit.name not in tokens]
    damaged = [token for token in tokens.values() if token.state == "failed"]
    listener.stage(stage, len(units), len(tokens) - len(damaged))
    for token in damaged:
        listener.end(token)
    workers = min(jobs, len(todo))
    if dask and todo:
        at_work = on_cluster(context, todo, listener, dask, jobs)
    elif workers > 1:
        at_work = in_processes(context, todo, listener, workers)
    else:
        at_work = _here(context, todo, listener)
    # Closed at once when the run is interrupted: worker processes end with it.
    by_name = {unit.name: unit for unit in todo}
    with closing(at_work):
        for token in at_work:
            tokens[token.unit] = token
            _keep_record(context, by_name[token.unit], token)
            listener.end(token)
    return [tokens[unit.name] for unit in units]


def _keep_record(context: Context, unit: Unit, token: Token) -> None:
    """Leave a record of a unit that failed; take away that of one that has succeeded."""
    from noiseid_cli.storage.failure_file import forget_failure, record_failure

    # A folder that takes no record any more, such as on a full disk, must not end the run: the token tells all.
    with suppress(DataError, OSError):
        if token.state == "failed":
            settings = context.at(unit.point_index).loaded.resolved()
            record_failure(unit.path, unit.name, token.message, token.tries, unit.key, settings)
        else:
            forget_failure(unit.path)


def _here(context: Context, units: Sequence[Unit], listener: Listener) -> Generator[Token]:
    for unit in units:
        yield make(context, unit, listener)

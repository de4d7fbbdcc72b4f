"""Runs the units of a stage, here, in several processes of this machine, or on a dask cluster.

A unit writes its own file before it returns; what travels back is a short token. So whatever ends a run, the files
that are there are complete, and the next run goes on with the missing ones. The results do not depend on the number of
processes or on the order. A unit that fails is a token too: the others go on, and a record of it stays in its place.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import closing, nullcontext, suppress

from noiseid_cli.errors import DataError
from noiseid_cli.models.threads import use_threads
from noiseid_cli.pipeline.cluster import LOCAL, on_cluster
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
    time_limit: float | None = None,
) -> list[Token]:
    """Make every unit that is not there; with ``force``, all of them.

    Args:
        context: the opened experiment.
        stage: name of the stage, for the listener.
        units: what to make, in order.
        listener: is told what goes on.
        jobs: number of processes; 1 works in this one, unless there is a time limit. Where there are fewer
            units, each works on several tests at once.
        force: make units anew that are there.
        wait: wait for a run that is at work in the same folder.
        dask: address of a dask scheduler that makes them, or ``local``; empty for processes of this machine.
        time_limit: longest time for one unit, s; it is ended then, with its process, and has failed. None: no limit.

    Returns:
        One token per unit, in the order of ``units``.

    Raises:
        MachineError: the disk is full or faulty; the units that are finished are kept.
        DataError: another run is at work in the same folder, there is not enough memory, or a time limit is set for a
            dask cluster.
    """
    from noiseid_cli.storage.lock import locked

    if dask and time_limit is not None:
        raise DataError(
            "--unit-timeout is for processes of this machine: dask ends no unit that runs; set the time limit of the "
            "cluster's own jobs"
        )
    there = {} if force else _look(units, {})
    # With nothing to make, a folder may be anybody's, or not be writable at all.
    at_rest = len(there) == len(units) and all(token.state != "damaged" for token in there.values())
    with nullcontext() if at_rest else locked(context.folder, listener.say, wait):
        if not at_rest and not force:
            there = _look(units, there)  # another run may have been at work meanwhile
        return _run(context, stage, units, there, listener, jobs, dask, time_limit)


def _look(units: Sequence[Unit], seen: dict[str, Token]) -> dict[str, Token]:
    """Tokens of the units that are there, by name; those that were found whole before are not looked at again."""
    whole = {name: token for name, token in seen.items() if token.state == "there"}
    return whole | {unit.name: found(unit) for unit in units if unit.name not in whole and unit.done}


def _run(
    context: Context,
    stage: str,
    units: Sequence[Unit],
    there: dict[str, Token],
    listener: Listener,
    jobs: int,
    dask: str,
    time_limit: float | None,
) -> list[Token]:
    from noiseid_cli.pipeline.memory import check_memory
    from noiseid_cli.storage.atomic import put_aside, sweep_parts

    for folder in {unit.path.parent for unit in units}:
        sweep_parts(folder)
    tokens = {name: token for name, token in there.items() if token.state != "damaged"}
    todo = [unit for unit in units if unit.name not in tokens]
    faulty = [token for token in tokens.values() if token.state == "failed"]
    listener.stage(stage, len(units), len(tokens) - len(faulty))
    for token in faulty:
        listener.end(token)
    for token in there.values():
        if token.state == "damaged":
            aside = put_aside(token.path)
            listener.say(f"{token.unit}: {token.message} It is kept as {aside.name}.")
    workers = min(jobs, len(todo))
    if not dask or dask == LOCAL:  # of other machines nothing is known here
        check_memory(context, todo, workers)
    if dask and todo:
        at_work = on_cluster(context, todo, listener, dask, jobs)
    elif workers > 1 or (todo and time_limit is not None):
        at_work = in_processes(context, todo, listener, workers, time_limit, jobs // workers)
    else:
        at_work = _here(context, todo, listener, jobs)
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

    # A folder that takes no record must not end the run: the token tells all. A full disk does, here as elsewhere.
    with suppress(DataError, OSError):
        if token.state == "failed":
            settings = context.at(unit.point_index).loaded.resolved()
            record_failure(unit.path, unit.name, token.message, token.tries, unit.key, settings)
        else:
            forget_failure(unit.path)


def _here(context: Context, units: Sequence[Unit], listener: Listener, threads: int) -> Generator[Token]:
    for unit in units:
        with use_threads(threads):
            token = make(context, unit, listener)
        yield token

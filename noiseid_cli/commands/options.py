"""Arguments and flags that commands share."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

F = TypeVar("F", bound=Callable[..., Any])

Config = Annotated[
    Path | None,
    typer.Argument(
        metavar="CONFIG",
        help="Experiment file. Default: ./noiseid.yaml, else the built-in flexible robot.",
        show_default=False,
    ),
]
ConfigOrResult = Annotated[
    Path | None,
    typer.Argument(
        metavar="CONFIG|RESULT",
        help="Experiment file, or a result file (.h5). Default: ./noiseid.yaml, else the built-in flexible robot.",
        show_default=False,
    ),
]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="A.B=VALUE", help="Replace a setting; may be given several times."),
]
Seed = Annotated[int | None, typer.Option("--seed", metavar="N", min=0, help="Replace the experiment's seed.")]
Jobs = Annotated[int, typer.Option("--jobs", "-j", metavar="N", min=1, help="Number of processes.")]
Out = Annotated[Path, typer.Option("--out", "-o", metavar="FOLDER", help="Folder of all experiments.")]
Force = Annotated[bool, typer.Option("--force", "-f", help="Do again what is done already.")]
DryRun = Annotated[bool, typer.Option("--dry-run", "-n", help="Say what would be done, and do nothing.")]
Wait = Annotated[bool, typer.Option("--wait", help="Wait for a run that is at work in the same folder.")]
Dask = Annotated[
    str,
    typer.Option(
        "--dask",
        metavar="ADDRESS",
        help="Work on the dask cluster with this scheduler (tls://HOST:PORT, tcp://HOST:PORT or its scheduler file), "
        "or local: --jobs workers on this machine.",
    ),
]
UnitTimeout = Annotated[
    float | None,
    typer.Option(
        "--unit-timeout",
        metavar="SECONDS",
        min=0.1,
        help="End a unit that takes longer, as failed; the others go on. Units then run in a process of their own even "
        "with --jobs 1. Default: no limit.",
        show_default=False,
    ),
]
Method = Annotated[
    list[str] | None,
    typer.Option(
        "--method",
        "-m",
        metavar="NAME",
        help="Label or method to run; may be given several times. Default: all of the experiment.",
    ),
]
Continue = Annotated[
    Path | None,
    typer.Option(
        "--continue",
        metavar="RESULT",
        help="A result of recursive-ml; the tests used now are taken in by it, the old ones are not needed.",
        show_default=False,
    ),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress, only the answer and errors.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Say more: each pass, each file.")]
Json = Annotated[bool, typer.Option("--json", help="The answer as JSON.")]

RUNS = Path("runs")


@dataclass(frozen=True)
class Flags:
    """The flags of every command that runs units of work, in the order of its help."""

    overrides: Set = None
    seed: Seed = None
    jobs: Jobs = 1
    out: Out = RUNS
    force: Force = False
    dry_run: DryRun = False
    wait: Wait = False
    dask: Dask = ""
    time_limit: UnitTimeout = None
    quiet: Quiet = False
    verbose: Verbose = False
    json: Json = False


def with_flags(command: F) -> F:
    """Show typer each flag of ``Flags`` in the place of the parameter ``flags`` of a command, behind its others."""
    own = [each for each in inspect.signature(command, eval_str=True).parameters.values() if each.name != "flags"]
    shared = inspect.signature(Flags, eval_str=True).parameters

    @functools.wraps(command)
    def wrapper(**given: Any) -> Any:
        flags = Flags(**{name: given.pop(name) for name in shared})
        return command(flags=flags, **given)

    wrapper.__signature__ = inspect.Signature([*own, *shared.values()])  # type: ignore[attr-defined]
    return wrapper  # type: ignore[return-value]


def with_continuation(flags: Flags, result: Path | None) -> Flags:
    """The flags, with the setting that ``--continue`` stands for."""
    if result is None:
        return flags
    import json

    return replace(
        flags, overrides=[*(flags.overrides or []), f"estimate.continue_from={json.dumps(str(result.absolute()))}"]
    )

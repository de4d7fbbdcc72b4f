"""`noiseid init`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from noiseid_cli.commands.console import answer, guarded
from noiseid_cli.commands.options import Force


@guarded
def init(
    path: Annotated[Path, typer.Argument(help="Where to write the experiment file.")] = Path("noiseid.yaml"),
    force: Force = False,
) -> None:
    """Write a commented starter experiment: the flexible robot, ready to run and to be changed."""
    from noiseid_cli.config.load import builtin_experiment
    from noiseid_cli.errors import DataError
    from noiseid_cli.storage.atomic import publish

    if path.exists() and not force:
        raise DataError(f"{path} is there already: give another name, or --force to replace it")
    publish(path, builtin_experiment().read_bytes())
    answer(f"wrote {path}; `noiseid check {path}` checks it, `noiseid run {path}` runs it")

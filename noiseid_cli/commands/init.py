"""`noiseid init`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from noiseid_cli.commands.console import answer, guarded


@guarded
def init(
    path: Annotated[Path, typer.Argument(metavar="FILE", help="Where to write it.")] = Path("noiseid.yaml"),
    force: Annotated[bool, typer.Option("--force", "-f", help="Replace a file that is there.")] = False,
) -> None:
    """Write a commented starter experiment.

    It runs as it is: EM on a simulated flexible robot. Its comments say what can be changed, and how to take
    recordings and a model of your own.
    """
    from noiseid_cli.errors import DataError
    from noiseid_cli.storage.atomic import publish

    if path.is_dir():
        path = path / "noiseid.yaml"
    if path.exists() and not force:
        raise DataError(f"{path} is there already: give another name, or --force to replace it")
    publish(path, Path(__file__).with_name("starter.yaml").read_bytes())
    name = "" if path == Path("noiseid.yaml") else f" {path}"
    answer(f"wrote {path}")
    answer(f"  noiseid check{name}   finds every mistake in it")
    answer(f"  noiseid run{name}     runs it")

"""`noiseid diff`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from noiseid_cli.commands.console import DIFFERENT, answer, answer_json, guarded, width
from noiseid_cli.commands.options import Json
from noiseid_cli.commands.text import table, wrapped
from noiseid_cli.pipeline.wording import counted


@guarded
def diff(
    a: Annotated[Path, typer.Argument(metavar="A", help="A dataset or result file, or a folder of them.")],
    b: Annotated[Path, typer.Argument(metavar="B", help="What to compare it with, of the same kind.")],
    rtol: Annotated[float, typer.Option("--rtol", min=0.0, help="Relative difference that is let pass.")] = 0.0,
    atol: Annotated[float, typer.Option("--atol", min=0.0, help="Absolute difference that is let pass.")] = 0.0,
    json: Json = False,
) -> None:
    """Compare datasets and results, number by number.

    Without a tolerance every bit counts, so that two runs of one experiment can be held against each other. Wall-clock
    times are left out. Folders, such as those of two runs, are compared file by file. Leaves with 5 where
    they differ.
    """
    from noiseid_cli.report.render_terminal import terminal_text
    from noiseid_cli.storage.difference import file_differences

    pairs, lone = _pairs(a, b)
    found = {name: file_differences(one, other, rtol, atol) for name, (one, other) in pairs.items()}
    differ = {name: differences for name, differences in found.items() if differences}
    if json:
        answer_json(
            {
                "compared": len(pairs),
                "only_in_one": lone,
                "differences": {
                    name: [vars(difference) for difference in differences] for name, differences in differ.items()
                },
            }
        )
    else:
        for name in lone:
            answer(wrapped(terminal_text(f"only in one: {name}"), width()))
        for name, differences in differ.items():
            answer(terminal_text(name))
            rows = [
                (terminal_text(d.name), terminal_text(d.what), _figure(d.absolute), _figure(d.relative))
                for d in differences
            ]
            for line in table(("variable", "differs in", "absolute", "relative"), rows, width()):
                answer(line)
        answer(f"{counted(len(pairs), 'file')} compared, {len(differ)} differ")
    if differ or lone:
        raise typer.Exit(DIFFERENT)


def _figure(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"


def _pairs(a: Path, b: Path) -> tuple[dict[str, tuple[Path, Path]], list[str]]:
    """The files to compare, by name, and those that only one folder has."""
    if not (a.is_dir() and b.is_dir()):
        return {a.name: (a, b)}, []
    ours, theirs = ({str(p.relative_to(folder)): p for p in sorted(folder.rglob("*.h5"))} for folder in (a, b))
    pairs = {name: (ours[name], theirs[name]) for name in ours if name in theirs}
    lone = [str(a / name) for name in ours if name not in theirs] + [str(b / n) for n in theirs if n not in ours]
    return pairs, lone

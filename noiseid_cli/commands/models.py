"""`noiseid models` and `noiseid models show`."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from noiseid_cli.commands.console import answer, answer_json, guarded, width
from noiseid_cli.commands.options import Json

if TYPE_CHECKING:
    from noiseid_cli.models.describe import Description

app = typer.Typer(help="List the models that come with noiseid, or show one.", invoke_without_command=True)


@app.callback()
@guarded
def list_models(ctx: typer.Context, json: Json = False) -> None:
    """List the models that come with noiseid, or show one."""
    if ctx.invoked_subcommand is not None:
        return
    from noiseid_cli.models.describe import describe
    from noiseid_cli.models.registry import load_model, model_names

    found = {name: describe(load_model(name)) for name in model_names()}
    if json:
        answer_json({name: d.summary for name, d in found.items()})
        return
    for name, description in found.items():
        answer(textwrap.fill(f"{name}: {description.summary.splitlines()[0]}", width(), subsequent_indent="  "))
    answer("`noiseid models show NAME` shows equations and parameters.")


@app.command("show")
@guarded
def show(
    name: Annotated[str, typer.Argument(help="Name of a model, or FILE.py:CLASS for one of your own.")],
    latex: Annotated[bool, typer.Option("--latex", help="The equations in LaTeX.")] = False,
    json: Json = False,
) -> None:
    """Show the equations of a model and its parameters with units and sources."""
    from noiseid_cli.models.describe import describe
    from noiseid_cli.models.registry import load_model, load_model_file

    file, _, class_name = name.rpartition(":")
    model = load_model_file(Path(file), class_name) if file.endswith(".py") else load_model(name)
    description = describe(model)
    if json:
        answer_json(
            {
                "name": description.name,
                "summary": description.summary,
                "citation": description.citation,
                "sample_time": description.sample_time,
                "discretisation": description.discretisation,
                "equations": [{"name": e.name, "kind": e.kind, "text": e.text} for e in description.equations],
                "tables": {
                    t.title: [dict(zip(t.headings, row, strict=True)) for row in t.rows] for t in description.tables
                },
            }
        )
    elif latex:
        answer("\\begin{align*}")
        answer(" \\\\\n".join(e.latex.replace(" = ", " &= ", 1) for e in description.equations))
        answer("\\end{align*}")
    else:
        _show(description)


def _show(d: Description) -> None:
    columns = width()
    answer(f"{d.name}: {textwrap.fill(d.summary.splitlines()[0], columns, initial_indent='').lstrip()}")
    for paragraph in d.summary.split("\n\n")[1:]:
        answer("\n" + textwrap.fill(paragraph, columns))
    answer(f"\nsample time {d.sample_time:g} s, discretisation {d.discretisation}")
    kind = ""
    for e in d.equations:
        if e.kind != kind:
            kind = e.kind
            answer(f"\n{kind}")
        answer(textwrap.fill(e.text, columns, initial_indent="  ", subsequent_indent="      ", break_long_words=False))
    for table in d.tables:
        answer(f"\n{table.title}")
        sizes = [max(len(row[i]) for row in (table.headings, *table.rows)) for i in range(len(table.headings))]
        for row in (table.headings, *table.rows):
            text = "  ".join(cell.ljust(size) for cell, size in zip(row, sizes, strict=True)).rstrip()
            answer(textwrap.fill(text, columns, initial_indent="  ", subsequent_indent=" " * 8, drop_whitespace=True)
                   if len(text) > columns - 2 else f"  {text}")  # fmt: skip
    if d.citation:
        answer("\n" + textwrap.fill(f"source: {d.citation}", columns))

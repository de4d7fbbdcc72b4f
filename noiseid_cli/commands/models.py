"""`noiseid models` and `noiseid models show`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from noiseid_cli.commands.console import answer, answer_json, guarded, width
from noiseid_cli.commands.options import Json
from noiseid_cli.commands.text import equation, facts, filled
from noiseid_cli.commands.text import table as table_lines

if TYPE_CHECKING:
    from noiseid_cli.models.describe import Description
    from noiseid_cli.models.equations import Model

_KINDS = {
    "definition": "definitions",
    "dynamics": "dynamics",
    "output": "output equations",
    "performance": "performance equations",
}

app = typer.Typer(help="List the models, or show one.", invoke_without_command=True)


@app.callback()
@guarded
def list_models(ctx: typer.Context, json: Json = False) -> None:
    """List the models that come with noiseid, or show one."""
    if ctx.invoked_subcommand is not None:
        return
    from noiseid_cli.models.describe import describe
    from noiseid_cli.models.registry import load_model, model_names

    found = {name: describe(load_model(name)).summary.splitlines()[0] for name in model_names()}
    if json:
        answer_json(found)
        return
    for line in facts(list(found.items()), width()):
        answer(line)
    answer("\n`noiseid models show NAME` shows the equations and the parameters of one.")


@app.command("show")
@guarded
def show(
    name: Annotated[
        str,
        typer.Argument(metavar="NAME", help="A model, FILE.py:CLASS for one of your own, or an experiment FILE.yaml."),
    ],
    latex: Annotated[bool, typer.Option("--latex", help="The equations in LaTeX.")] = False,
    json: Json = False,
) -> None:
    """Show a model's equations, and its parameters with units and sources."""
    from noiseid_cli.models.describe import describe

    description = describe(_load(name))
    if json:
        answer_json(_as_data(description))
        return
    for line in _latex(description) if latex else _text(description, width()):
        answer(line)


def _load(name: str) -> Model:
    """A model that comes with noiseid, one of the user's own file, or that of an experiment."""
    from noiseid_cli.models.registry import find_model

    if not name.endswith((".yaml", ".yml")):
        return find_model(name)
    from noiseid_cli.config.load import load_experiment
    from noiseid_cli.pipeline.context import Context

    return Context(load_experiment(Path(name)), Path(), lambda _: None).model


def _as_data(d: Description) -> dict[str, object]:
    return {
        "name": d.name,
        "summary": d.summary,
        "citation": d.citation,
        "sample_time": d.sample_time,
        "discretisation": d.discretisation,
        "equations": [{"name": e.name, "kind": e.kind, "text": e.text, "latex": e.latex} for e in d.equations],
        "tables": {t.title: [dict(zip(t.headings, row, strict=True)) for row in t.rows] for t in d.tables},
    }


def _latex(d: Description) -> Iterator[str]:
    """One align environment, for a document that uses the package amsmath."""
    yield r"\begin{align*}"
    yield " \\\\\n".join("  " + e.latex.replace(" = ", " &= ", 1) for e in d.equations)
    yield r"\end{align*}"


def _text(d: Description, columns: int) -> Iterator[str]:
    first, *others = d.summary.split("\n\n")
    yield filled(f"{d.name}: {first}", columns)
    for paragraph in others:
        yield "\n" + filled(paragraph, columns)
    yield f"\nsample time {d.sample_time:g} s, discretisation {d.discretisation}"
    kind = ""
    for e in d.equations:
        if e.kind != kind:
            kind = e.kind
            yield f"\n{_KINDS[kind]}"
        yield from equation(e.text, columns)
    for table in d.tables:
        yield f"\n{table.title}"
        yield from table_lines(table.headings, table.rows, columns)
    if d.citation:
        yield "\n" + filled(f"source: {d.citation}", columns, then="  ")

"""The `noiseid` command: which commands exist, nothing else."""

from __future__ import annotations

import gc
import io
import os
import sys
from typing import Annotated

# One BLAS thread: the matrices are small, and the bits must not depend on the number of cores.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import typer  # noqa: E402

from noiseid_cli import __version__  # noqa: E402
from noiseid_cli.commands import (  # noqa: E402
    check,
    cite,
    diagnose,
    diff,
    env,
    estimate,
    export,
    import_,
    init,
    inspect,
    methods,
    models,
    report,
    run,
    schema,
    simulate,
    status,
)
from noiseid_cli.commands.console import guarded, stop_on_signals  # noqa: E402

app = typer.Typer(
    name="noiseid",
    help="Identify the noise covariances of a state-space model from recordings.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Start with `noiseid init`, or try `noiseid run` bare: it takes the built-in flexible robot.\n\n"
    "Exit codes: 0 done; 1 the machine failed (disk full) or a bug, the message says which; 2 wrong usage; "
    "3 wrong experiment or data; 4 some units failed or did not converge; 5 `diff` found differences; 130 interrupted.",
)

app.command()(run.run)
app.command()(simulate.simulate)
app.command("import")(import_.import_)
app.command()(estimate.estimate)
app.command()(report.report)
app.command()(diagnose.diagnose)
app.command()(export.export)
app.command()(status.status)
app.command()(check.check)
app.command()(init.init)
app.command()(inspect.inspect)
app.command()(diff.diff)
app.command()(methods.methods)
app.command()(cite.cite)
app.command()(env.env)
app.command()(schema.schema)
app.add_typer(models.app, name="models")


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"noiseid {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Identify the noise covariances of a state-space model from recordings."""


def main() -> None:
    """Entry point of the `noiseid` command."""
    gc.set_threshold(10_000)  # imports make half a million objects that stay: search them less often
    stop_on_signals()
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a terminal that lacks a letter shows a question mark
    try:
        guarded(app)()  # help and version are printed outside the commands
    except typer.Exit as end:
        sys.exit(end.exit_code)
    finally:
        gc.freeze()  # all ends with the process: no last search for what could be freed

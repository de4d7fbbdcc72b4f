"""`noiseid report`."""

from __future__ import annotations

from noiseid_cli.commands.console import guarded
from noiseid_cli.commands.options import RUNS, Config, Json, Method, Out, Quiet, Seed, Set


@guarded
def report(
    config: Config = None,
    method: Method = None,
    overrides: Set = None,
    seed: Seed = None,
    out: Out = RUNS,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Make tables, figures and pages from the results that are there."""
    from noiseid_cli.commands.stages import open_session, show_report

    show_report(open_session(config, out, overrides, seed, quiet=quiet, json=json), method)

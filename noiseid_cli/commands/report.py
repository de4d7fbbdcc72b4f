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
    """Make tables, figures and pages from the results.

    Takes all results that are there, and says which are missing.
    """
    from noiseid_cli.commands.stages import open_session

    session = open_session(config, out, overrides, seed, quiet=quiet, json=json)
    session.finish(session.report(method, anew=True))

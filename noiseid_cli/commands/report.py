"""`noiseid report`."""

from __future__ import annotations

from noiseid_cli.commands.console import guarded
from noiseid_cli.commands.options import RUNS, Config, Flags, Json, Method, Out, Quiet, Seed, Set


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
    from noiseid_cli.commands.stages import open_job

    job = open_job(config, Flags(overrides, seed, out=out, quiet=quiet, json=json))
    job.finish(job.report(method, anew=True))

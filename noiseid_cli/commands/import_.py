"""`noiseid import`."""

from __future__ import annotations

from noiseid_cli.commands.console import guarded
from noiseid_cli.commands.options import (
    RUNS,
    Config,
    Dask,
    DryRun,
    Force,
    Jobs,
    Json,
    Out,
    Quiet,
    Seed,
    Set,
    UnitTimeout,
    Verbose,
    Wait,
)


@guarded
def import_(
    config: Config = None,
    overrides: Set = None,
    seed: Seed = None,
    jobs: Jobs = 1,
    out: Out = RUNS,
    force: Force = False,
    dry_run: DryRun = False,
    wait: Wait = False,
    dask: Dask = "",
    time_limit: UnitTimeout = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
    json: Json = False,
) -> None:
    """Import recordings, each fault named by its row."""
    from noiseid_cli.commands.stages import open_job

    job = open_job(
        config,
        out,
        overrides,
        seed,
        jobs=jobs,
        force=force,
        dry_run=dry_run,
        wait=wait,
        dask=dask,
        time_limit=time_limit,
        quiet=quiet,
        verbose=verbose,
        json=json,
    )
    job.make_data("import")
    job.finish()

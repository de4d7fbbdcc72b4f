"""`noiseid estimate`."""

from __future__ import annotations

from noiseid_cli.commands.console import guarded
from noiseid_cli.commands.options import (
    RUNS,
    Config,
    Continue,
    Dask,
    DryRun,
    Force,
    Jobs,
    Json,
    Method,
    Out,
    Quiet,
    Seed,
    Set,
    UnitTimeout,
    Verbose,
    Wait,
    with_continuation,
)


@guarded
def estimate(
    config: Config = None,
    method: Method = None,
    overrides: Set = None,
    go_on: Continue = None,
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
    """Run the methods on the datasets.

    The datasets must be there: `noiseid simulate` or `noiseid import` makes them, with the same settings.
    """
    from noiseid_cli.commands.stages import open_job
    from noiseid_cli.pipeline.reporting import show_results

    job = open_job(
        config,
        out,
        with_continuation(overrides, go_on),
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
    job.estimate(method)
    job.finish(None if dry_run else show_results(job.context, method))

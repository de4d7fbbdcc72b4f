"""`noiseid run`."""

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
    Method,
    Out,
    Quiet,
    Seed,
    Set,
    UnitTimeout,
    Verbose,
    Wait,
)


@guarded
def run(
    config: Config = None,
    method: Method = None,
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
    """Simulate or import, estimate, report: all that is not done yet.

    What is done is not done again: each file is named by a key of all settings and data that it depends on. So a run
    that was interrupted goes on where it was, and a changed setting makes new files beside the old ones.
    """
    from noiseid_cli.commands.stages import open_job
    from noiseid_cli.pipeline.units import chosen_methods, data_stage, dataset_units

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
    context = job.context
    estimates = context.experiment.estimate is not None
    if estimates or method:
        chosen_methods(context, method)  # a wrong name is told before anything is made
    job.run(data_stage(context), dataset_units(context))
    if estimates:
        job.estimate(method)
    job.finish(job.report(method) if estimates and not dry_run else None)

"""`noiseid run`."""

from __future__ import annotations

from noiseid_cli.commands.console import guarded
from noiseid_cli.commands.options import Config, Flags, Method, with_flags


@guarded
@with_flags
def run(flags: Flags, config: Config = None, method: Method = None) -> None:
    """Simulate or import, estimate, report: all that is not done yet.

    What is done is not done again: each file is named by a key of all settings and data that it depends on. So a run
    that was interrupted goes on where it was, and a changed setting makes new files beside the old ones.
    """
    from noiseid_cli.commands.stages import open_job
    from noiseid_cli.pipeline.units import chosen_methods, data_stage, dataset_units

    job = open_job(config, flags)
    context = job.context
    estimates = context.experiment.estimate is not None
    if estimates or method:
        chosen_methods(context, method)  # a wrong name is told before anything is made
    job.run(data_stage(context), dataset_units(context))
    if estimates:
        job.estimate(method)
    job.finish(job.report(method) if estimates and not flags.dry_run else None)

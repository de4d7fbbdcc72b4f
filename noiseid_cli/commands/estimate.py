"""`noiseid estimate`."""

from __future__ import annotations

from noiseid_cli.commands.console import guarded
from noiseid_cli.commands.options import Config, Continue, Flags, Method, with_continuation, with_flags


@guarded
@with_flags
def estimate(flags: Flags, config: Config = None, method: Method = None, go_on: Continue = None) -> None:
    """Run the methods on the datasets.

    The datasets must be there: `noiseid simulate` or `noiseid import` makes them, with the same settings.
    """
    from noiseid_cli.commands.stages import open_job
    from noiseid_cli.pipeline.reporting import show_results

    job = open_job(config, with_continuation(flags, go_on))
    job.estimate(method)
    job.finish(None if flags.dry_run else show_results(job.context, method))

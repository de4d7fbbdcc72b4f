"""`noiseid simulate`."""

from __future__ import annotations

from noiseid_cli.commands.console import guarded
from noiseid_cli.commands.options import Config, Flags, with_flags


@guarded
@with_flags
def simulate(flags: Flags, config: Config = None) -> None:
    """Simulate datasets, with the truth stored beside the data."""
    from noiseid_cli.commands.stages import open_job

    job = open_job(config, flags)
    job.make_data("simulate")
    job.finish()

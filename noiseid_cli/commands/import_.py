"""`noiseid import`."""

from __future__ import annotations

from noiseid_cli.commands.console import guarded
from noiseid_cli.commands.options import Config, Flags, with_flags


@guarded
@with_flags
def import_(flags: Flags, config: Config = None) -> None:
    """Import recordings, each fault named by its row."""
    from noiseid_cli.commands.stages import open_job

    job = open_job(config, flags)
    job.make_data("import")
    job.finish()

"""`noiseid env`."""

from __future__ import annotations

from noiseid_cli.commands.console import answer, answer_json, guarded, width
from noiseid_cli.commands.options import Json
from noiseid_cli.commands.text import facts


@guarded
def env(json: Json = False) -> None:
    """Show what the numbers depend on: versions, machine, folders."""
    from noiseid_cli.models.compile import cache_folder
    from noiseid_cli.storage.provenance import provenance

    found = {**provenance(), "model cache": str(cache_folder())}
    if json:
        answer_json(found)
        return
    for line in facts(list(found.items()), width()):
        answer(line)

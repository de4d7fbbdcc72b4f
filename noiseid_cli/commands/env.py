"""`noiseid env`."""

from __future__ import annotations

from noiseid_cli.commands.console import answer, answer_json, guarded
from noiseid_cli.commands.options import Json


@guarded
def env(json: Json = False) -> None:
    """Show what the numbers depend on: versions, machine, folders."""
    from noiseid_cli.models.compile import cache_folder
    from noiseid_cli.storage.provenance import provenance

    facts = {**provenance(), "model cache": str(cache_folder())}
    if json:
        answer_json(facts)
        return
    for name, value in facts.items():
        answer(f"{name:12} {value}")

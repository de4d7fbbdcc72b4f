"""`noiseid schema`."""

from __future__ import annotations

from noiseid_cli.commands.console import answer_json, guarded


@guarded
def schema() -> None:
    """Print the JSON Schema of experiment files, for editors."""
    from noiseid_cli.config.json_schema import json_schema

    answer_json(json_schema())

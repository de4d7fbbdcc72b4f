"""`noiseid methods`."""

from __future__ import annotations

import textwrap

from noiseid_cli.commands.console import answer, answer_json, guarded, width
from noiseid_cli.commands.options import Json


@guarded
def methods(json: Json = False) -> None:
    """List the estimation methods: what each can estimate, its options, its source."""
    from noiseid_cli.config.methods import METHOD_OPTIONS

    table = {
        name: {
            "summary": options.summary,
            "estimates": options.estimates,
            "options": {
                field: {"default": info.default, "description": info.description}
                for field, info in options.model_fields.items()
                if field != "method"
            },
            "citation": options.citation,
        }
        for name, options in METHOD_OPTIONS.items()
    }
    if json:
        answer_json(table)
        return
    for options_class in METHOD_OPTIONS.values():
        name = options_class.model_fields["method"].default
        answer(f"{name}: {options_class.summary}")
        answer(f"  estimates  {options_class.estimates}")
        for field, info in options_class.model_fields.items():
            if field != "method":
                text = f"{field} = {info.default}: {info.description}"
                answer(textwrap.fill(text, width(), initial_indent="  ", subsequent_indent="      "))
        answer(textwrap.fill(f"source: {options_class.citation}", width(), initial_indent="  ", subsequent_indent="  "))

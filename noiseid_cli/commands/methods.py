"""`noiseid methods`."""

from __future__ import annotations

from noiseid_cli.commands.console import answer, answer_json, guarded, width
from noiseid_cli.commands.options import Json
from noiseid_cli.commands.text import facts, filled


@guarded
def methods(json: Json = False) -> None:
    """List the methods: what each estimates, its options, its source."""
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
    for number, (name, options) in enumerate(METHOD_OPTIONS.items()):
        answer(filled(f"{name}: {options.summary}", width(), "" if number == 0 else "\n", "  "))
        pairs = [("estimates", options.estimates), ("options", "")]
        pairs += [
            (f"  {field}", f"{info.description} (default {_short(info.default)})")
            for field, info in options.model_fields.items()
            if field != "method"
        ]
        for line in facts([*pairs, ("source", options.citation)], width(), "  "):
            answer(line)


def _short(default: object) -> str:
    return f"{default:g}" if isinstance(default, float) else str(default)

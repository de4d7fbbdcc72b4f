"""`noiseid methods`."""

from __future__ import annotations

from noiseid_cli.commands.console import answer, answer_json, guarded, width
from noiseid_cli.commands.options import Json
from noiseid_cli.commands.text import facts, filled, table


@guarded
def methods(json: Json = False) -> None:
    """List the methods: what each estimates, its options, its source."""
    from noiseid_cli.config.method_base import KINDS, STRUCTURES
    from noiseid_cli.config.methods import METHOD_OPTIONS

    found = {
        name: {
            "summary": options.summary,
            "estimates": options.estimates,
            "unknowns": [kind for kind in KINDS if kind in options.can],
            "structures": [word for word in STRUCTURES if word in options.structures],
            "options": {
                field: {
                    "default": None if info.is_required() else info.default,
                    "required": info.is_required(),
                    "description": info.description,
                }
                for field, info in options.model_fields.items()
                if field != "method"
            },
            "citation": options.citation,
        }
        for name, options in METHOD_OPTIONS.items()
    }
    if json:
        answer_json(found)
        return
    _overview()
    for name, options in METHOD_OPTIONS.items():
        answer(filled(f"{name}: {options.summary}", width(), "\n", "  "))
        pairs = [("estimates", options.estimates), ("options", "")]
        pairs += [
            (
                f"  {field}",
                f"{info.description} ({'required' if info.is_required() else f'default {_short(info.default)}'})",
            )
            for field, info in options.model_fields.items()
            if field != "method"
        ]
        for line in facts([*pairs, ("source", options.citation)], width(), "  "):
            answer(line)


def _overview() -> None:
    """Method by kind of unknown and structure of the process noise."""
    from noiseid_cli.config.method_base import KINDS, STRUCTURES
    from noiseid_cli.config.methods import METHOD_OPTIONS

    rows = []
    for name, options in METHOD_OPTIONS.items():
        marks = ("yes" if kind in options.can else "-" for kind in KINDS)
        words = [word for word in STRUCTURES if word in options.structures]
        taken = "all" if len(words) == len(STRUCTURES) else ", ".join(words)
        rows.append((name, *marks, taken if "Q" in options.can else "-"))
    for line in table(("method", *KINDS, "structures of Q"), rows, width(), ""):
        answer(line)
    answer(filled(f"All structures: {', '.join(STRUCTURES)}.", width(), "\n"))


def _short(default: object) -> str:
    if default in ({}, ()):
        return "none"
    return f"{default:g}" if isinstance(default, float) else str(default)

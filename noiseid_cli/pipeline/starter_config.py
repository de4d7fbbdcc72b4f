"""The text of a starter experiment: each choice with the reason for it in a comment."""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Iterator, Sequence

from noiseid_cli.pipeline.starter import MODEL_CLASS, MODEL_FILE, Plan
from noiseid_cli.pipeline.starter_values import Value, first_state, measurement_stds, process_stds
from noiseid_cli.recordings.table import Key

_WIDTH = 110
_WORDS = frozenset({"null", "true", "false", "yes", "no", "on", "off", "nan", "inf", "n", "y"})


def config_text(plan: Plan) -> str:
    """The experiment file."""
    parts = [_head(plan), _model(plan), _import(plan), _estimate(plan)]
    return "\n".join("\n".join(part) + "\n" for part in parts)


def _head(plan: Plan) -> Iterator[str]:
    rows = len(plan.found.table.row_numbers)
    yield from _comment(
        f"Written by `noiseid init` after a look at {plan.log.name}: {rows} rows, {plan.time.interval:.6g} s apart, "
        f"{len(plan.found.columns)} columns. Each choice has its reason beside it: correct what is wrong, then"
    )
    yield "#   noiseid check      finds every mistake in this file, and runs nothing"
    yield "#   noiseid run        imports the log, estimates, and writes a report"
    yield ""
    yield f"experiment: {_scalar(plan.label)}"
    yield "seed: 1"


def _model(plan: Plan) -> Iterator[str]:
    if plan.model is None:
        yield from _comment(
            "A model to begin with: every output is a position that the inputs and a random acceleration drive. "
            "It runs, and knows no physics: what it leaves out counts as noise. Put your own equations into the file."
        )
        yield f"model: {{file: {MODEL_FILE}, class: {MODEL_CLASS}}}"
        return
    yield f"# `noiseid models show {plan.model_name}` prints its equations and its parameters."
    file, _, class_name = plan.model_name.rpartition(":")
    if file.endswith(".py"):
        from pathlib import Path

        yield f"model: {{file: {_scalar(plan.relative(Path(file)))}, class: {class_name}}}"
    else:
        yield f"model: {{name: {plan.model_name}}}"


def _import(plan: Plan) -> Iterator[str]:
    time = plan.time
    yield "import:"
    yield "  recordings:"
    yield f"    {_scalar(plan.label)}: {{file: {_scalar(plan.relative(plan.log))}}}"
    if plan.found.source.decimal != ".":
        yield from _noted('  format: {decimal: ","}', "numbers are written with a decimal comma")
    if time.key is None:
        yield from _noted(f"  time: {{interval: {time.interval:.10g}}}", time.why)
    else:
        scale = "" if time.scale == 1.0 else f", scale: {time.scale:g}"
        yield from _comment(f"{time.key} is the time: {time.why}", 2)
        yield f"  time: {{column: {_scalar(time.key)}{scale}}}"
    yield "  # The model's name: the column. A unit is changed by {column: NAME, scale: FACTOR, offset: NUMBER}."
    roles = {role.key: role for role in plan.roles}
    for word, columns in (("inputs", plan.inputs), ("outputs", plan.outputs)):
        if columns:
            yield f"  {word}:"
        for name, key in columns.items():
            role = roles[key]
            why = role.why if role.role == word[:-1] else "as given" if plan.model is None else "by its name"
            yield from _noted(f"    {_scalar(name)}: {_scalar(key)}", f"{why}; {_facts(plan, key)}")
    used = {*plan.inputs.values(), *plan.outputs.values()}
    for role in plan.roles:
        if role.key not in used:
            yield from _comment(
                f"left out: {role.key}: " + (role.why if role.role == "left out" else "not asked for"), 2
            )
    yield from _on_problem(plan)


def _facts(plan: Plan, key: Key) -> str:
    column = plan.found.column(key)
    step = f"steps of {column.step:.3g}" if column.step else "no steps"
    if column.constant:
        return "it never changes"
    missing = f", {column.missing + column.bad} of {len(column.values)} missing" if column.missing + column.bad else ""
    low, high = float(column.known.min()), float(column.known.max())
    return f"{low:.3g} to {high:.3g}, {step}{missing}"


def _on_problem(plan: Plan) -> Iterator[str]:
    yield from _comment(
        "Faults of the log, and what to do about them. Kinds that are not listed stop the import with their rows.", 2
    )
    if not plan.proposals:
        yield from _noted("  on_problem: {}", "none were found")
        return
    yield "  on_problem:"
    for proposal in plan.proposals:
        yield from _noted(f"    {proposal.problem}: {proposal.choice}", proposal.why)


def _estimate(plan: Plan) -> Iterator[str]:
    yield "# Q and R are found from these starts. Q is per sample: the noise is held over each interval."
    yield "estimate:"
    yield "  process_noise:"
    structure = "diagonal" if plan.model is None else "full"
    why = "a variance for each noise" if plan.model is None else "with correlations; or diagonal"
    yield from _noted(f"    structure: {structure}", why)
    yield from _stds("    start", process_stds(plan))
    yield "  measurement_noise:"
    yield from _noted("    structure: diagonal", "sensors that do not share their noise")
    yield from _stds("    start", measurement_stds(plan))
    mean, std = first_state(plan)
    yield "  initial_mean:"
    yield f"    known: [{', '.join(f'{value.number:.9g}' for value in mean)}]"
    yield from (line for value in mean for line in _comment(value.why, 6))
    yield "  initial_covariance:"
    yield from _stds("    known", std)
    yield "  methods:"
    yield from _noted("    em: {}", "`noiseid methods` lists the others and all options")


def _stds(key: str, values: Sequence[Value]) -> Iterator[str]:
    yield f"{key}: {{std: [{', '.join(_number(value.number) for value in values)}]}}"
    yield from (line for value in values for line in _comment(value.why, 6))


def _number(value: float) -> str:
    return f"{value:.3g}"


def _noted(line: str, why: str) -> Iterator[str]:
    """A line with its reason behind it, or below it where there is no room."""
    padded = f"{line:<42}"
    if len(padded) + len(why) + 4 <= _WIDTH:
        yield f"{padded}  # {why}"
        return
    yield line
    yield from _comment(why, len(line) - len(line.lstrip()) + 2)


def _comment(text: str, indent: int = 0) -> Iterator[str]:
    begin = " " * indent + "# "
    yield from textwrap.wrap(
        text, _WIDTH, initial_indent=begin, subsequent_indent=begin, break_long_words=False, break_on_hyphens=False
    )


def _scalar(value: Key) -> str:
    """A name or number as YAML reads it back; quoted where YAML would take it for something else."""
    if isinstance(value, int):
        return str(value)
    plain = re.fullmatch(r"(\.\.?/|/)*[A-Za-z_][\w./-]*", value, re.ASCII) and value.lower() not in _WORDS
    return value if plain else json.dumps(value, ensure_ascii=False)

"""`noiseid check`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from noiseid_cli.commands.console import answer, answer_json, guarded, width
from noiseid_cli.commands.options import RUNS, Config, Flags, Json, Method, Out, Quiet, Seed, Set
from noiseid_cli.commands.text import facts
from noiseid_cli.pipeline.wording import counted

if TYPE_CHECKING:
    from noiseid_cli.pipeline.making import Unit


@guarded
def check(
    config: Config = None,
    method: Method = None,
    overrides: Set = None,
    seed: Seed = None,
    out: Out = RUNS,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Find every mistake in an experiment.

    Reads the experiment file and its model, and runs nothing. Each mistake is told with its line and column.
    With --json, the settings with every default filled in.
    """
    from noiseid_cli.commands.stages import open_job
    from noiseid_cli.config.load import builtin_experiment
    from noiseid_cli.pipeline.memory import check_memory, in_words, memory_needs, memory_there
    from noiseid_cli.pipeline.units import data_stage, dataset_units, estimate_units

    context = open_job(config, Flags(overrides, seed, out=out, quiet=quiet)).context
    model = context.model
    units: dict[str, Sequence[Unit]] = {data_stage(context): dataset_units(context)}
    if context.experiment.estimate or method:
        units["estimate"] = estimate_units(context, method)
    stages = {stage: [unit.done for unit in made] for stage, made in units.items()}
    to_do = [unit for made in units.values() for unit in made if not unit.done]
    check_memory(context, to_do, 1)
    if json:
        answer_json(context.loaded.resolved())
        return
    builtin = context.loaded.file == builtin_experiment()
    answer(f"{'the built-in experiment' if builtin else context.loaded.file}: no mistakes found")
    sizes = ((model.states, "state"), (model.inputs, "input"), (model.noises, "noise"), (model.outputs, "output"))
    pairs = [("model", f"{model.name}: {', '.join(counted(len(group), word) for group, word in sizes)}")]
    for stage, done in stages.items():
        pairs.append((stage, f"{counted(len(done), 'unit')}, {sum(done)} there already"))
    if to_do:
        need, there = memory_needs(context, to_do)[0][0], memory_there()
        pairs.append(("memory", f"about {in_words(need)} at once for the largest unit; {in_words(there)} are free"))
    pairs.append(("folder", str(context.folder)))
    for line in facts(pairs, width(), "  "):
        answer(line)

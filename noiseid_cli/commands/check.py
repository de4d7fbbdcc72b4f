"""`noiseid check`."""

from __future__ import annotations

from noiseid_cli.commands.console import answer, answer_json, guarded
from noiseid_cli.commands.options import RUNS, Config, Json, Out, Quiet, Seed, Set


@guarded
def check(
    config: Config = None,
    overrides: Set = None,
    seed: Seed = None,
    out: Out = RUNS,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Check an experiment file and its model without running anything; every mistake with its place."""
    from noiseid_cli.commands.stages import open_session
    from noiseid_cli.pipeline.units import dataset_units, estimate_units

    session = open_session(config, out, overrides, seed, quiet=quiet)
    context = session.context
    context.model.equations()
    datasets = dataset_units(context)
    results = estimate_units(context) if context.experiment.estimate else []
    if json:
        answer_json(context.loaded.resolved())
        return
    there = sum(u.done for u in datasets), sum(u.done for u in results)
    answer(f"{context.loaded.file}: right")
    answer(f"  model     {context.model.name}")
    answer(f"  datasets  {len(datasets)}, {there[0]} there already")
    answer(f"  results   {len(results)}, {there[1]} there already")
    answer(f"  folder    {context.folder}")

"""`noiseid run`."""

from __future__ import annotations

from noiseid_cli.commands.console import guarded
from noiseid_cli.commands.options import RUNS, Config, DryRun, Force, Jobs, Json, Method, Out, Quiet, Seed, Set, Verbose


@guarded
def run(
    config: Config = None,
    method: Method = None,
    overrides: Set = None,
    seed: Seed = None,
    jobs: Jobs = 1,
    out: Out = RUNS,
    force: Force = False,
    dry_run: DryRun = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    json: Json = False,
) -> None:
    """Do all that an experiment says: simulate or import, estimate, report. What is done is not done again."""
    from noiseid_cli.commands.stages import open_session, show_report
    from noiseid_cli.pipeline.units import dataset_units, estimate_units

    session = open_session(
        config, out, overrides, seed, jobs=jobs, force=force, dry_run=dry_run, quiet=quiet, verbose=verbose, json=json
    )
    experiment = session.context.experiment
    datasets = session.run("simulate" if experiment.simulate else "import", dataset_units(session.context))
    if experiment.estimate is None:
        session.finish(datasets, "datasets")
        return
    session.run("estimate", estimate_units(session.context, method))
    if not dry_run:
        show_report(session, method)

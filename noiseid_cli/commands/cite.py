"""`noiseid cite`."""

from __future__ import annotations

from noiseid_cli.commands.console import answer, answer_json, guarded, width
from noiseid_cli.commands.options import Config, Flags, Json, Method, Quiet, Set
from noiseid_cli.commands.text import filled


@guarded
def cite(
    config: Config = None, method: Method = None, overrides: Set = None, quiet: Quiet = False, json: Json = False
) -> None:
    """Print what to cite for an experiment.

    These are the works behind its methods and its model.
    """
    from noiseid_cli.commands.stages import open_job
    from noiseid_cli.pipeline.reporting import citations

    papers = citations(open_job(config, Flags(overrides, quiet=quiet)).context, method)
    if json:
        answer_json(papers)
        return
    for paper in papers:
        answer(filled(paper, width(), "- ", "  "))

"""`noiseid cite`."""

from __future__ import annotations

import textwrap

from noiseid_cli.commands.console import answer, answer_json, guarded, width
from noiseid_cli.commands.options import RUNS, Config, Json, Quiet, Set


@guarded
def cite(config: Config = None, overrides: Set = None, quiet: Quiet = False, json: Json = False) -> None:
    """Print what to cite for the methods and the model that an experiment uses."""
    from noiseid_cli.commands.stages import open_session
    from noiseid_cli.pipeline.reporting import citations

    context = open_session(config, RUNS, overrides, None, quiet=quiet).context
    papers = citations(context)
    if json:
        answer_json(papers)
        return
    for paper in papers:
        answer(textwrap.fill(paper, width(), initial_indent="- ", subsequent_indent="  "))

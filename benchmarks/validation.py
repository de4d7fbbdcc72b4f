"""Statistical claims as experiments: runs them and prints bias, reported errors, coverage and efficiency in one table.

`python benchmarks/validation.py RUNS JOBS`; what is done is not computed again. From nothing it takes about half an
hour of processor time for em and ml, and more for the ensembles of Porter et al. (1983).
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from noiseid_cli.pipeline.context import open_experiment
from noiseid_cli.pipeline.reporting import gather
from noiseid_cli.report.render_markdown import markdown_table
from noiseid_cli.report.validation import figures_table, validated, validation_table

CONFIGS = Path(__file__).parents[1] / "configs"
EXPERIMENTS = (
    CONFIGS / "validation" / "linear_two_state.yaml",
    CONFIGS / "validation" / "rank_one.yaml",
    CONFIGS / "validation" / "flexible_robot.yaml",
    CONFIGS / "porter1983_replicates.yaml",
)
NOT_ALL_CONVERGED = 4


def main(runs: Path, jobs: str) -> None:
    """Run each experiment, then print both tables as Markdown."""
    found = []
    for config in EXPERIMENTS:
        command = [sys.executable, "-m", "noiseid_cli", "run", str(config), "--jobs", jobs, "--out", str(runs)]
        ran = subprocess.run(command, stdout=subprocess.DEVNULL, check=False)
        if ran.returncode not in (0, NOT_ALL_CONVERGED):
            sys.exit(ran.returncode)
        study, _ = gather(open_experiment(config, runs))
        found += validated(study)
    print(markdown_table(validation_table(found)))
    print(markdown_table(figures_table(found)))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])

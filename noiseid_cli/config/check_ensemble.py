"""Do the settings of an ensemble of tests fit the model?"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from noiseid_cli.config.document import Path
from noiseid_cli.config.schema_estimate import Estimate
from noiseid_cli.config.suggest import did_you_mean

Add = Callable[[Path, str], None]


def check_ensemble(add: Add, estimate: Estimate, states: Sequence[str], outputs: Sequence[str]) -> None:
    """Check the map of the first state and the bias that tests share.

    Args:
        add: takes each problem with the path to its setting.
        estimate: the section.
        states, outputs: names of the model's states and outputs.
    """
    chosen = estimate.initial_map
    if chosen is not None:
        matrices: dict[Path, Sequence[Sequence[float]]] = {}
        if chosen.matrix is not None:
            matrices["matrix",] = chosen.matrix
        matrices |= {("tests", name): matrix for name, matrix in (chosen.tests or {}).items()}
        for place, T in matrices.items():
            _check_map(add, ("estimate", "initial_map", *place), T, states, chosen.names)
    if estimate.common_bias is not None:
        for i, name in enumerate(estimate.common_bias.outputs):
            if name not in outputs:
                known = ", ".join(outputs)
                add(
                    ("estimate", "common_bias", "outputs", i),
                    f"{name} is not one of the model's outputs: {known}{did_you_mean(name, outputs)}",
                )


def _check_map(
    add: Add, path: Path, matrix: Sequence[Sequence[float]], states: Sequence[str], names: Sequence[str]
) -> None:
    if len(matrix) != len(states):
        add(path, f"has {len(matrix)} rows, but the model has {len(states)} states: {', '.join(states)}")
    for i, row in enumerate(matrix):
        if len(row) != len(names):
            add((*path, i), f"has {len(row)} numbers, but there are {len(names)} names: {', '.join(names)}")

"""`noiseid inspect`."""

from __future__ import annotations

import json as json_module
from pathlib import Path
from typing import Annotated, Any

import typer

from noiseid_cli.commands.console import answer, answer_json, guarded
from noiseid_cli.commands.options import Json


@guarded
def inspect(
    file: Annotated[Path, typer.Argument(help="A dataset or result file.")],
    config: Annotated[bool, typer.Option("--config", help="The settings that made it, as JSON.")] = False,
    json: Json = False,
) -> None:
    """Show what is in a dataset or result file, after checking that it is whole."""
    from noiseid_cli.storage.hdf5 import read_format
    from noiseid_cli.storage.result_file import FORMAT as RESULT

    facts, attributes = _result(file) if read_format(file) == RESULT else _dataset(file)
    if config:
        answer_json(json_module.loads(attributes["config"]))
    elif json:
        answer_json(facts)
    else:
        for name, value in facts.items():
            answer(f"{name:14} {value}")


def _dataset(file: Path) -> tuple[dict[str, Any], dict[str, str]]:
    import numpy as np

    from noiseid_cli.storage.dataset_file import read_attributes, read_dataset

    dataset = read_dataset(file)
    facts: dict[str, Any] = {
        "dataset": dataset.name,
        "model": dataset.model,
        "tests": len(dataset.recordings),
        "samples": [r.samples for r in dataset.recordings],
        "duration, s": [round(float(r.dt.sum()), 6) for r in dataset.recordings],
        "missing": sum(int(np.isnan(r.y).sum()) for r in dataset.recordings),
        "inputs": ", ".join(f"{name} [{unit}]" for name, unit, _ in dataset.inputs),
        "outputs": ", ".join(f"{name} [{unit}]" for name, unit, _ in dataset.outputs),
        "truth": "known" if dataset.Q_true is not None else "not known",
        "notes": " ".join(dataset.notes) or "none",
    }
    return facts, read_attributes(file)


def _result(file: Path) -> tuple[dict[str, Any], dict[str, str]]:
    import numpy as np

    from noiseid_cli.storage.result_file import read_result, read_result_attributes

    result = read_result(file)
    estimate = result.estimate
    facts: dict[str, Any] = {
        "result": result.unit,
        "method": estimate.method,
        "status": estimate.status,
        "reason": estimate.reason,
        "passes": estimate.passes,
        "loglik": estimate.loglik,
        "std Q": _std(np.diag(estimate.final.Q), result.noise_names),
        "std R": _std(np.diag(estimate.final.R), result.output_names),
        "safeguards": "; ".join(estimate.safeguards) or "none acted",
    }
    return facts, read_result_attributes(file)


def _std(variances: Any, columns: tuple[tuple[str, str, str], ...]) -> str:
    return ", ".join(f"{c[0]} {v**0.5:.6g} {c[1]}" for v, c in zip(variances, columns, strict=True))

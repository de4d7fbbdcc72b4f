"""`noiseid inspect`."""

from __future__ import annotations

import json as json_module
from pathlib import Path
from typing import Annotated, Any

import typer

from noiseid_cli.commands.console import answer, answer_json, guarded, width
from noiseid_cli.commands.options import Json
from noiseid_cli.commands.text import facts as fact_lines


@guarded
def inspect(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Dataset or result files.")],
    config: Annotated[bool, typer.Option("--config", help="The settings that made each, as JSON.")] = False,
    json: Json = False,
) -> None:
    """Show what is in dataset and result files.

    Each file is checked to be whole first.
    """
    from noiseid_cli.storage.hdf5 import read_format
    from noiseid_cli.storage.result_file import FORMAT as RESULT

    found = []
    for file in files:
        facts, attributes = _result(file) if read_format(file) == RESULT else _dataset(file)
        facts = {"file": Fact(str(file)), **facts, "key": Fact(attributes["key"])}
        found.append((facts, json_module.loads(attributes["config"])))
    if config or json:
        data = [settings if config else {name: fact.data for name, fact in facts.items()} for facts, settings in found]
        answer_json(data if len(data) > 1 else data[0])
        return
    for number, (facts, _) in enumerate(found):
        if number:
            answer("")
        for line in fact_lines([(name, fact.text) for name, fact in facts.items()], width()):
            answer(line)


class Fact:
    """Something about a file: as data for programs, and in words."""

    def __init__(self, data: Any, text: str | None = None) -> None:
        """Words for a list or mapping of texts are its items."""
        self.data = data
        if text is None and isinstance(data, dict):
            text = ", ".join(f"{name} {value}".rstrip() for name, value in data.items()) or "none"
        elif text is None:
            text = ("; ".join(data) or "none") if isinstance(data, list) else str(data)
        self.text = text


def _dataset(file: Path) -> tuple[dict[str, Fact], dict[str, str]]:
    import numpy as np

    from noiseid_cli.storage.dataset_file import read_attributes, read_dataset

    dataset = read_dataset(file)
    tests = [(r.name, r.samples, float(r.dt.sum())) for r in dataset.recordings]
    missing = sum(int(np.isnan(r.y).sum()) for r in dataset.recordings)
    known = dataset.Q_true is not None
    return {
        "dataset": Fact(dataset.name),
        "model": Fact(dataset.model),
        "tests": Fact(
            [{"name": name, "samples": samples, "seconds": seconds} for name, samples, seconds in tests],
            "; ".join(f"{name}: {samples} samples, {seconds:.6g} s" for name, samples, seconds in tests),
        ),
        "missing": Fact(missing, f"{missing} of {sum(r.y.size for r in dataset.recordings)} measurements"),
        "inputs": Fact({name: unit for name, unit, _ in dataset.inputs}),
        "outputs": Fact({name: unit for name, unit, _ in dataset.outputs}),
        "truth": Fact(known, "known" if known else "not known"),
        "notes": Fact(list(dataset.notes)),
    }, read_attributes(file)


def _result(file: Path) -> tuple[dict[str, Fact], dict[str, str]]:
    from noiseid_cli.storage.result_file import read_result, read_result_attributes

    result = read_result(file)
    estimate = result.estimate
    final = estimate.final
    return {
        "result": Fact(result.unit),
        "method": Fact(estimate.method),
        "status": Fact(estimate.status),
        "reason": Fact(estimate.reason),
        "passes": Fact(estimate.passes),
        "seconds": Fact(estimate.seconds, f"{estimate.seconds:.3g}"),
        "loglik_start": Fact(estimate.loglik_start),
        "loglik": Fact(estimate.loglik),
        "Q": Fact(final.Q.tolist(), _std(final.Q, result.noise_names)),
        "R": Fact(final.R.tolist(), _std(final.R, result.output_names)),
        "safeguards": Fact(list(estimate.safeguards)),
    }, read_result_attributes(file)


def _std(covariance: Any, columns: tuple[tuple[str, str, str], ...]) -> str:
    """The standard deviations with their units."""
    variances = covariance.diagonal().tolist()
    deviations = ", ".join(f"{c[0]} {v**0.5:.6g} {c[1]}".rstrip() for c, v in zip(columns, variances, strict=True))
    return f"standard deviations {deviations}"

"""What was estimated from what, in sentences that are true of what ran."""

from __future__ import annotations

import math
from typing import Literal

from noiseid_cli.report.noise_units import unit_words
from noiseid_cli.report.reading import converged, covariances, group, remark, std
from noiseid_cli.report.study import Study
from noiseid_cli.report.tables import Column, write_number

Which = Literal["Q", "R"]
_KINDS: dict[Which, str] = {"Q": "process noise", "R": "measurement noise"}
_VALUE = Column("value")


def count_sentence(study: Study) -> str:
    """How many units converged, and how the others ended."""
    total = len(study.results)
    good = sum(converged(r) for r in study.results)
    others = group([r for r in study.results if not converged(r)], lambda r: r.estimate.status)
    rest = ", ".join(f"{len(units)} {status}" for status, units in others.items())
    return f"{good} of {total} {'unit' if total == 1 else 'units'} converged" + (f" ({rest})." if rest else ".")


def kinds(study: Study, which: Which) -> set[str]:
    """What became of the variances of Q or R over all units: estimated, held, unchanged."""
    return {
        remark(r, which, i)
        for r in study.results
        for i in range(len(r.noise_names if which == "Q" else r.output_names))
    }


def problem_sentence(study: Study) -> str:
    """From which outputs what was estimated, and what kept the values given."""
    moved, kept = [], []
    for which in ("Q", "R"):
        found = kinds(study, which)
        what = f"the covariance {which} of the {_KINDS[which]}"
        if "estimated" not in found:
            kept.append(what)
        else:
            moved.append(f"{what}{' in part' if 'held' in found else ''} ({_names(study, which)})")
    parameters = dict.fromkeys(
        name for r in study.results if r.estimate.parameters is not None for name, _, _ in r.estimate.parameters.names
    )
    if parameters:
        moved.append(f"{'the parameter' if len(parameters) == 1 else 'the parameters'} {', '.join(parameters)}")
    outputs = _listed(study.results[0].output_names)
    text = f"From {'the output' if len(study.results[0].output_names) == 1 else 'the outputs'} {outputs}, "
    text += f"{_joined(moved)} {'were' if len(moved) > 1 or len(parameters) > 1 else 'was'} estimated." if moved else ""
    text = text if moved else f"From {outputs}, nothing moved from the values given."
    return text + (f" {_joined(['T' + kept[0][1:], *kept[1:]])} kept the values given." if moved and kept else "")


def _names(study: Study, which: Which) -> str:
    r = study.results[0]
    return _listed(r.noise_names if which == "Q" else r.output_names)


def _listed(names: tuple[tuple[str, str, str], ...]) -> str:
    return ", ".join(f"{name} [{unit}]" if unit else name for name, unit, _ in names)


def _joined(parts: list[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def sizes_sentence(study: Study) -> str:
    """How many units there are of how many methods, starts and datasets; empty for one."""
    units = study.results
    counts = (
        (len({u.method_label for u in units}), "method"),
        (len({u.start_index for u in units}), "start"),
        (len({u.dataset for u in units}), "dataset"),
        (len({u.replicate for u in units}), "replicate"),
    )
    told = [_count(n, noun) for n, noun in counts if n > 1]
    return f"{_count(len(units), 'unit')}: {', '.join(told)}." if told else ""


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def kept_sentence(study: Study, which: Which) -> str | None:
    """The standard deviations that no unit moved, as a sentence; None where they moved or differ between units."""
    if not study.results or "estimated" in kinds(study, which):
        return None
    index = 0 if which == "Q" else 1
    r = study.results[0]
    names = r.noise_names if which == "Q" else r.output_names
    rows = {tuple(std(covariances(u, "start")[index], i) for i in range(len(names))) for u in study.results}
    if len(rows) > 1:
        return None
    told = []
    for i, ((name, unit, _), value) in enumerate(zip(names, rows.pop(), strict=True)):
        truth = std(covariances(r, "truth")[index], i)
        text = " ".join(filter(None, [name, str(write_number(value, _VALUE)), unit]))
        apart = math.isfinite(truth) and not math.isclose(truth, value, rel_tol=1e-9, abs_tol=0.0)
        told.append(f"{text} (truth {write_number(truth, _VALUE)})" if apart else text)
    words = f" {unit_words(study)}" if which == "Q" else ""
    return f"The standard deviations of the {_KINDS[which]}{words} kept the values given: {', '.join(told)}."

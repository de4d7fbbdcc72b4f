"""The content of a report, once for all formats: headings that ask, and blocks that answer."""

from __future__ import annotations

from dataclasses import dataclass

from noiseid_cli.outcome import UnitResult
from noiseid_cli.report import agreement, build, certainty, comparison, diagnosis, facts, published, sweep, tracking
from noiseid_cli.report.figure_style import Plot
from noiseid_cli.report.figures import convergence_plot, std_plots
from noiseid_cli.report.figures_misfit import misfit_plot
from noiseid_cli.report.figures_online import online_plots
from noiseid_cli.report.figures_time import autocorrelation_plot, nis_plot, path_error_plot
from noiseid_cli.report.noise_units import noise_units_table
from noiseid_cli.report.over_tests import approach_table, ensemble_plot
from noiseid_cli.report.parameter_recovery import parameter_recovery
from noiseid_cli.report.reading import best, converged, group, remark
from noiseid_cli.report.recovery import recovery_table
from noiseid_cli.report.side_by_side import compared, side_by_side
from noiseid_cli.report.study import Study
from noiseid_cli.report.tables import Table
from noiseid_cli.report.unknown_parameters import parameter_estimates, profile_plot


@dataclass(frozen=True)
class Paragraph:
    """Text in one paragraph."""

    text: str


@dataclass(frozen=True)
class Bullets:
    """A list of sentences."""

    items: tuple[str, ...]


@dataclass(frozen=True)
class Code:
    """Lines to be shown exactly as they are."""

    text: str


Block = Paragraph | Bullets | Code | Table | Plot


@dataclass(frozen=True)
class Section:
    """A heading, the anchor to it, and what stands below."""

    anchor: str
    heading: str
    blocks: tuple[Block, ...]


def sections(study: Study) -> list[Section]:
    """All sections of a report, in order; those without content are left out."""
    parts = [
        Section("warnings", "What must be known first?", _warnings(study)),
        Section("estimate", "The estimate: before and after", _estimate(study)),
        Section("problem", "What was estimated from what?", _problem(study)),
        Section("sweep", "What do the varied settings change?", _sweep(study)),
        Section("deviations", "Which standard deviations?", _deviations(study)),
        Section("unknown-parameters", "Which parameters?", _parameters(study)),
        Section("certainty", "How sure is the estimate?", _certainty(study)),
        Section("starts", "Do the starts agree?", _starts(study)),
        Section("methods", "How do the methods compare?", _comparison(study)),
        Section("online", "How did the estimates move over time?", _online(study)),
        Section("published", "How does this compare with what is published?", _published(study)),
        Section("path", "How was the estimate reached?", _path(study)),
        Section("agreement", "Does the filter agree with the data?", _agreement(study)),
        Section("model", "Which model?", _model(study)),
        Section("reproduce", "How can this be done again?", _reproduce(study)),
        Section("environment", "On what did it run?", _environment(study)),
    ]
    return [part for part in parts if part.blocks]


def count_sentence(study: Study) -> str:
    """How many units converged, and how the others ended."""
    total = len(study.results)
    good = sum(converged(r) for r in study.results)
    others = group([r for r in study.results if not converged(r)], lambda r: r.estimate.status)
    rest = ", ".join(f"{len(units)} {status}" for status, units in others.items())
    return f"{good} of {total} {'unit' if total == 1 else 'units'} converged" + (f" ({rest})." if rest else ".")


def _warnings(study: Study) -> tuple[Block, ...]:
    found = list(study.warnings)
    if not study.results:
        found.append("There are no results: no unit has run yet.")
    elif not all(converged(r) for r in study.results):
        found.append(f"{count_sentence(study)} The others are shown, but not part of any mean.")
    found += certainty.ridges(study)
    return (Bullets(tuple(found)),) if found else ()


def _problem(study: Study) -> tuple[Block, ...]:
    if not study.results:
        return (facts.dataset_table(study),) if study.datasets else ()
    r = study.results[0]
    blocks: list[Block] = [
        Paragraph(f"Model: {study.model.name}. {study.model.description}"),
        Paragraph(
            f"From the outputs {_listed(r.output_names)}, the covariance Q of the process noise "
            f"{_listed(r.noise_names)} was estimated; {_fate_of_R(study)}."
        ),
        Paragraph(
            f"{_count(len(study.results), 'unit')}: {_count(len({u.method_label for u in study.results}), 'method')}, "
            f"{_count(len({u.start_index for u in study.results}), 'start')}, "
            f"{_count(len({u.dataset for u in study.results}), 'dataset')}, "
            f"{_count(len({u.replicate for u in study.results}), 'replicate')}. {count_sentence(study)}"
        ),
    ]
    if study.datasets:
        blocks.append(facts.dataset_table(study))
        notes = [f"{d.name}: {note}" for d in study.datasets for note in d.notes]
        blocks += [Bullets(tuple(dict.fromkeys(notes)))] if notes else []
    return (*blocks, facts.method_table(study))


def _listed(names: tuple[tuple[str, str, str], ...]) -> str:
    return ", ".join(f"{name} [{unit}]" if unit else name for name, unit, _ in names)


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def _fate_of_R(study: Study) -> str:
    kinds = _kinds_of_R(study)
    if "estimated" not in kinds:
        return "the covariance R of the measurement noise was held at the values given"
    return "so was the covariance R of the measurement noise" + (" in part" if "held" in kinds else "")


def _kinds_of_R(study: Study) -> set[str]:
    return {remark(r, "R", i) for r in study.results for i in range(len(r.output_names))}


def _estimate(study: Study) -> tuple[Block, ...]:
    if not study.results:
        return ()
    units = (build.before_after_table(study), build.ending_table(study))
    if len(study.results) == 1:
        return units
    summary = build.summary_table(study)
    return (summary, *units) if len(study.results) > build.MANY else (*units, summary)


def _sweep(study: Study) -> tuple[Block, ...]:
    if study.sweep is None or not study.results:
        return ()
    varied = [f"{axis}: {text}" for axis, text in zip(study.sweep.axes, study.sweep.settings, strict=True)]
    return (Bullets(tuple(varied)), sweep.sweep_table(study), *sweep.sweep_plots(study))


def _deviations(study: Study) -> tuple[Block, ...]:
    if not study.results:
        return ()
    if study.sweep and len(study.results) > build.MANY:  # the points may have truths of their own: no means over them
        return tuple(build.correlation_tables(study))
    many = len(study.results) > build.MANY
    table = build.std_summary_table if many else build.std_table
    # Of many units, an R that nobody estimated would be a long table of one value.
    held = many and "estimated" not in _kinds_of_R(study)
    tables = (table(study, "Q"),) if held else (table(study, "Q"), table(study, "R"))
    both = noise_units_table(study)
    return (*tables, *([both] if both else []), *build.correlation_tables(study))


def _parameters(study: Study) -> tuple[Block, ...]:
    together = side_by_side(study)
    # What stands side by side needs no long table of its own, and many units stand in the table of their means.
    needless = len(study.results) > build.MANY or (together and len(compared(study)) == len(study.results))
    tables = (together, None if needless else parameter_estimates(study))
    blocks = (*tables, ensemble_plot(study), approach_table(study), parameter_recovery(study), profile_plot(study))
    return tuple(block for block in blocks if block)


def _certainty(study: Study) -> tuple[Block, ...]:
    told = certainty.certainty_sentences(study)
    bullets: tuple[Block, ...] = (Bullets(tuple(told)),) if told else ()
    return (*bullets, *certainty.certainty_tables(study))


def _starts(study: Study) -> tuple[Block, ...]:
    if not agreement.start_groups(study):
        return ()
    return (Bullets(tuple(agreement.start_sentences(study))), agreement.starts_table(study))


def _comparison(study: Study) -> tuple[Block, ...]:
    several = len({r.method_label for r in study.results}) > 1 or any(r.held_out for r in study.results)
    scores = comparison.score_table(study) if several else None
    plots = [comparison.best_paths_plot(study), *comparison.start_paths_plots(study)] if several else []
    return tuple(block for block in (scores, recovery_table(study), *plots) if block)


def _online(study: Study) -> tuple[Block, ...]:
    tables = (tracking.tracking_table(study), tracking.hold_table(study))
    found = tracking.tracking_sentences(study)
    blocks: list[Block] = [Bullets(tuple(found))] if found else []
    return (*blocks, *(table for table in tables if table), *online_plots(study))


def _published(study: Study) -> tuple[Block, ...]:
    blocks: list[Block] = [*published.published_tables(study)]
    found = published.published_sentences(study)
    if found:
        blocks += [Paragraph("What was found:"), Bullets(tuple(found))]
    if study.claims:
        blocks += [
            Paragraph("What the source claims, to be held against the tables above:"),
            Bullets(tuple(study.claims)),
        ]
    return tuple(blocks)


def _path(study: Study) -> tuple[Block, ...]:
    plots = tuple(plot for plot in (convergence_plot(study), *std_plots(study)) if plot)
    acted = _safeguards(study)
    return (*plots, Paragraph("Safeguards that acted:"), Bullets(acted)) if acted else plots


def _safeguards(study: Study) -> tuple[str, ...]:
    """Each safeguard that acted, with the units in which it did."""
    units: dict[str, list[str]] = {}
    for r in study.results:
        for text in r.estimate.safeguards:
            units.setdefault(text, []).append(r.unit)
    return tuple(
        f"{names[0]}: {text}" if len(names) == 1 else f"{names[0]} and {len(names) - 1} more: {text}"
        for text, names in units.items()
    )


def _agreement(study: Study) -> tuple[Block, ...]:
    if not any(r.evaluations for r in study.results):
        return ()
    plots = (path_error_plot(study), nis_plot(study), misfit_plot(study), autocorrelation_plot(study))
    shown = best(study.results)
    cases = [diagnosis.case_of(r, _interval(study, r)) for r in shown]
    blocks: list[Block] = [diagnosis.overall_table(cases), agreement.consistency_table(study)]
    blocks.append(diagnosis.output_table(cases, "estimate"))
    where = diagnosis.where_table(cases, "estimate")
    blocks += [where] if where else []
    for case in cases:
        blocks += [
            Paragraph(f"What is left unexplained at the estimate of {case.name}:"),
            Bullets(tuple(diagnosis.verdict(case, "estimate"))),
        ]
    return (*blocks, *(plot for plot in plots if plot))


def _interval(study: Study, result: UnitResult) -> float | None:
    """Mean interval between samples, s."""
    data = study.dataset(result.dataset)
    return data.duration / (data.samples - data.tests) if data and data.samples > data.tests else None


def _model(study: Study) -> tuple[Block, ...]:
    blocks: list[Block] = [Paragraph(f"{study.model.name}: {study.model.description}")]
    if study.model.equations:
        blocks.append(Code("\n".join(study.model.equations)))
    if study.model.parameters:
        blocks.append(facts.parameter_table(study))
    return tuple(blocks)


def _reproduce(study: Study) -> tuple[Block, ...]:
    blocks: list[Block] = [Code("\n".join(study.reproduce))] if study.reproduce else []
    if study.citations:
        blocks += [Paragraph("Papers behind the methods:"), Bullets(tuple(study.citations))]
    return tuple(blocks)


def _environment(study: Study) -> tuple[Block, ...]:
    return (facts.environment_table(study),) if study.environment else ()

"""The content of a report, once for all formats: headings that ask, and blocks that answer."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from noiseid_cli.outcome import UnitResult
from noiseid_cli.report import (
    agreement,
    answer,
    build,
    certainty,
    comparison,
    diagnosis,
    facts,
    published,
    sweep,
    tracking,
)
from noiseid_cli.report.before_after import before_after_table
from noiseid_cli.report.blocks import Block, Bullets, Code, Equations, Paragraph, Section
from noiseid_cli.report.figures import convergence_plot, std_plots
from noiseid_cli.report.figures_misfit import misfit_plot
from noiseid_cli.report.figures_online import online_plots
from noiseid_cli.report.figures_time import autocorrelation_plot, nis_plot, path_error_plot
from noiseid_cli.report.noise_units import noise_units_table
from noiseid_cli.report.over_tests import approach_table, ensemble_plot
from noiseid_cli.report.parameter_recovery import parameter_recovery
from noiseid_cli.report.reading import best, converged
from noiseid_cli.report.recovery import correlation_recovery_table, recovery_table
from noiseid_cli.report.shown import lean, with_short_names
from noiseid_cli.report.side_by_side import compared, side_by_side
from noiseid_cli.report.study import Study
from noiseid_cli.report.tables import Table
from noiseid_cli.report.unknown_parameters import parameter_estimates, profile_plot


def sections(study: Study) -> list[Section]:
    """All sections of a report that have content: the answer first, then what it rests on."""
    study = with_short_names(study)
    parts = [
        Section("warnings", "What must be known first?", _warnings(study)),
        Section("estimate", "What does the estimate change?", _estimate(study)),
        Section("sweep", "What do the varied settings change?", _sweep(study)),
        Section("deviations", "How large is the noise?", _deviations(study)),
        Section("unknown-parameters", "What are the parameters?", _parameters(study)),
        Section("certainty", "How sure is the estimate?", _certainty(study)),
        Section("online", "How did the estimates move over time?", _online(study)),
        Section("agreement", "Does the filter agree with the data?", _agreement(study)),
        Section("starts", "Do the starts agree?", _starts(study)),
        Section("methods", "How do the methods compare?", _comparison(study)),
        Section("published", "How does this compare with what is published?", _published(study)),
        Section("path", "How was the estimate reached?", _path(study)),
        Section("problem", "Which data and which methods?", _problem(study)),
        Section("model", "Which model?", _model(study)),
        Section("reproduce", "How can this be done again?", _reproduce(study)),
        Section("environment", "On what did it run?", _environment(study)),
    ]
    return [replace(part, blocks=tuple(_lean(part.blocks, study))) for part in parts if part.blocks]


def _lean(blocks: tuple[Block, ...], study: Study) -> Iterator[Block]:
    for block in blocks:
        yield lean(block, study) if isinstance(block, Table) else block


def _warnings(study: Study) -> tuple[Block, ...]:
    found = list(study.warnings)
    if not study.results:
        found.append("There are no results: no unit has run yet.")
    elif not all(converged(r) for r in study.results):
        found.append(f"{answer.count_sentence(study)} The others are shown, but not part of any mean.")
    found += certainty.ridges(study)
    return (Bullets(tuple(found)),) if found else ()


def _estimate(study: Study) -> tuple[Block, ...]:
    if not study.results:
        return ()
    told = Paragraph(f"{answer.problem_sentence(study)} {answer.sizes_sentence(study)}".strip())
    if len(study.results) > build.MANY:
        chosen = best(study.results)
        some = before_after_table(replace(study, results=chosen))
        note = f" Of {len(study.results)} units the best of each method and dataset; results.csv holds all."
        return (told, build.summary_table(study), replace(some, caption=some.caption + note))
    return (told, before_after_table(study))


def _problem(study: Study) -> tuple[Block, ...]:
    blocks: list[Block] = []
    if study.datasets:
        blocks.append(facts.dataset_table(study))
        notes = [
            note if note.startswith(f"{d.name}:") else f"{d.name}: {note}" for d in study.datasets for note in d.notes
        ]
        blocks += [Bullets(tuple(dict.fromkeys(notes)))] if notes else []
    return (*blocks, facts.method_table(study)) if study.results else tuple(blocks)


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
    table = build.std_summary_table if len(study.results) > build.MANY else build.std_table
    blocks: list[Block] = []
    for which in ("Q", "R"):
        kept = answer.kept_sentence(study, which)
        blocks.append(Paragraph(kept) if kept else table(study, which))
    both = noise_units_table(study) if "estimated" in answer.kinds(study, "Q") else None
    return (*blocks, *([both] if both else []), *build.correlation_tables(study))


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
    few = 1 < len(study.results) <= build.MANY and several
    means = build.summary_table(study) if few else None
    scores = comparison.score_table(study) if several else None
    plots = [comparison.best_paths_plot(study), *comparison.start_paths_plots(study)] if several else []
    recovered = (recovery_table(study), correlation_recovery_table(study))
    return tuple(block for block in (means, scores, *recovered, *plots) if block)


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
    if not study.results:
        return ()
    plots = tuple(plot for plot in (convergence_plot(study), *std_plots(study)) if plot)
    endings = build.ending_table(study)
    if len(study.results) > build.MANY:
        failed = [r for r in study.results if not converged(r)]
        some = build.ending_table(replace(study, results=failed))
        note = f" Only those of {len(study.results)} that did not converge; results.csv holds all."
        endings = replace(some, caption=some.caption + note)
    blocks: list[Block] = [endings, *plots] if endings.rows else [*plots]
    acted = _safeguards(study)
    return (*blocks, Paragraph("Safeguards that acted:"), Bullets(acted)) if acted else tuple(blocks)


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
    blocks: list[Block] = []
    for case in cases:
        of = f" of {case.name}" if len(study.results) > 1 else ""
        blocks += [
            Paragraph(f"What is left unexplained at the estimate{of}:"),
            Bullets(tuple(diagnosis.verdict(case, "estimate"))),
        ]
    blocks += [diagnosis.overall_table(cases), agreement.consistency_table(study)]
    where = diagnosis.where_table(cases, "estimate")
    blocks += [where] if where else []
    return (*blocks, *(plot for plot in plots if plot))


def _interval(study: Study, result: UnitResult) -> float | None:
    """Mean interval between samples, s."""
    data = study.dataset(result.dataset)
    return data.duration / (data.samples - data.tests) if data and data.samples > data.tests else None


_EQUATIONS = {
    "definition": "Definitions",
    "dynamics": "Dynamics",
    "output": "Outputs",
    "performance": "Performance",
}


def _model(study: Study) -> tuple[Block, ...]:
    blocks: list[Block] = [Paragraph(f"{study.model.name}: {study.model.description}")]
    for kind, title in _EQUATIONS.items():
        lines = tuple(e for e in study.model.equations if e.kind == kind)
        blocks += [Equations(title, lines)] if lines else []
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

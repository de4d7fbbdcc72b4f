"""Tables of what went in: datasets, methods, the model's parameters, the environment."""

from __future__ import annotations

from noiseid_cli.report.reading import converged, group
from noiseid_cli.report.study import Study
from noiseid_cli.report.tables import Column, Table, number


def dataset_table(study: Study) -> Table:
    """Sizes and origin of each dataset."""
    columns = (
        Column("Dataset"),
        Column("Origin"),
        Column("Tests"),
        Column("Samples"),
        Column("Duration", "s"),
        Column("Missing", "%", digits=3),
    )
    rows = tuple(
        (
            d.name,
            d.origin,
            d.tests,
            d.samples,
            number(d.duration, "Not known"),
            number(100 * d.missing_share, "Not known"),
        )
        for d in study.datasets
    )
    return Table("datasets", "Datasets", "Missing: share of the scalar measurements that is not there.", columns, rows)


def method_table(study: Study) -> Table:
    """What ran under each label, with its settings, and how many of its units converged."""
    rows = []
    for label, units in group(study.results, lambda r: r.method_label).items():
        settings = "; ".join(f"{key}: {value}" for key, value in units[0].estimate.settings.items())
        good = sum(converged(u) for u in units)
        rows.append((label, units[0].estimate.method, f"{good} / {len(units)}", settings))
    columns = (Column("Label"), Column("Method"), Column("Converged / all"), Column("Settings"))
    return Table("methods", "Methods", "", columns, tuple(rows))


def parameter_table(study: Study) -> Table:
    """The model's parameters and where each value comes from."""
    columns = (
        Column("Parameter"),
        Column("Value", digits=6),
        Column("In"),
        Column("Meaning"),
        Column("Source"),
    )
    rows = tuple(
        (p.name, number(p.value, "Not given"), p.unit or "1", p.description, p.source or "not stated")
        for p in study.model.parameters
    )
    caption = "Chosen: the source leaves the value open, and it was chosen for this model."
    return Table("parameters", f"Parameters of {study.model.name}", caption, columns, rows)


def environment_table(study: Study) -> Table:
    """Versions and machine."""
    columns = (Column("What"), Column("Value"))
    return Table("environment", "Environment", "", columns, tuple(study.environment.items()))

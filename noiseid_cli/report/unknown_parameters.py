"""Model parameters that were estimated: a table with their errors, and profile likelihoods."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from noiseid_cli.estimators.estimate import Series
from noiseid_cli.outcome import UnitResult
from noiseid_cli.report.figure_style import INK, Plot, legend_above, method_colours, panels, plot_text
from noiseid_cli.report.over_time import over_time
from noiseid_cli.report.study import Study
from noiseid_cli.report.tables import Cell, Column, Table, number

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PROFILE = "profile_"
"""Beginning of the names of the curves that are profile likelihoods."""

# Half the 95 % quantile of the chi-square distribution with one degree of freedom.
DROP = 1.92
MOST = 6


def parameter_estimates(study: Study) -> Table | None:
    """Start, estimate, standard error and truth of each estimated parameter; None where there is none.

    Methods whose estimates move over time have tables of their own.
    """
    rows: list[tuple[Cell, ...]] = []
    for r in study.results:
        found = r.estimate.parameters
        if found is None or over_time(r):
            continue
        for i, (name, unit, _) in enumerate(found.names):
            error = None if found.standard_errors is None else float(found.standard_errors[i])
            truth = None if r.parameters_true is None else float(r.parameters_true[i])
            rows.append((
                r.unit, name, unit or "1", float(found.start[i]), float(found.final[i]),
                number(error, "No standard error: at a bound, not determined by the data, or none by this method"),
                number(truth, "The truth is not known"),
            ))  # fmt: skip
    if not rows:
        return None
    columns = (
        Column("Unit"), Column("Parameter"), Column("In"), Column("Start", digits=5), Column("Estimate", digits=5),
        Column("Standard error", digits=3), Column("Truth", digits=5),
    )  # fmt: skip
    caption = "Standard errors as the method reports them, with all other unknowns free."
    return Table("parameter-estimates", "Estimated parameters of the model", caption, columns, tuple(rows), keys=2)


def profile_plot(study: Study) -> Plot | None:
    """Profile likelihoods, a panel for each; None where none was asked."""
    found = [(r, s) for r in study.results for s in r.estimate.series if s.name.startswith(PROFILE)]
    if not found:
        return None
    more = f" The first {MOST} of {len(found)} are drawn." if len(found) > MOST else ""
    told = "; ".join(f"{r.unit}: {s.title}" for r, s in found[:MOST])
    caption = (
        "The greatest log-likelihood at each value of one unknown, all others free, less the maximum. Dashed: the "
        "parabola that the standard error stands for; where the curves part, its interval misleads. Values below the "
        f"dotted line are rejected at 5 %. {told}.{more}"
    )
    return Plot("profiles", "Profile likelihood", caption, partial(_draw, study, found[:MOST]))


def _draw(study: Study, found: list[tuple[UnitResult, Series]]) -> Figure:
    colours = method_colours([r.method_label for r in study.results])
    figure, axes = panels(len(found), 2, 2.9)
    for axis, (r, s) in zip(axes, found, strict=False):
        colour = colours[r.method_label]
        axis.plot(s.at, s.values[:, 0], "o-", color=colour, markersize=3, label=plot_text(r.method_label))
        axis.plot(s.at, s.values[:, 1], linestyle=(0, (4, 2)), color=INK, linewidth=1.0, label="parabola")
        axis.axhline(-DROP, linestyle=":", color=INK, linewidth=1.0, label="rejected below, at 5 %")
        name, unit = s.axis
        axis.set_xlabel(plot_text(f"{name} [{unit}]" if unit else name))
        axis.set_ylabel("log-likelihood")
    legend_above(figure, axes[0])
    return figure

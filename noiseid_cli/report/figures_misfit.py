"""Figure of where the misfit sits: the NIS against the quantities that it follows most."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from noiseid_cli.outcome import UnitResult
from noiseid_cli.report.diagnosis import case_of, misfit_curves
from noiseid_cli.report.figure_style import BAND, Plot, method_colours, panels, plot_text
from noiseid_cli.report.reading import best
from noiseid_cli.report.study import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def misfit_plot(study: Study) -> Plot | None:
    """NIS at the estimate over ranges of the quantities that it follows most; the first best unit that has any."""
    unit = next((r for r in best(study.results) if misfit_curves(case_of(r), "estimate")), None)
    if unit is None:
        return None
    caption = (
        f"Unit {unit.unit}, filter at the estimate: mean NIS over ten ranges of equally many samples of each quantity, "
        "the four that it follows most. The band of 95 % is that of a consistent filter; a shape over a state points "
        "at the model's terms in it."
    )
    return Plot("misfit", "Where the misfit sits", caption, partial(_draw, study, unit))


def _draw(study: Study, unit: UnitResult) -> Figure:
    curves = misfit_curves(case_of(unit), "estimate")
    figure, axes = panels(len(curves), 2 if len(curves) > 1 else 1, 1.75, share_x=False)
    colour = method_colours([u.method_label for u in study.results])[unit.method_label]
    for axis, misfit in zip(axes, curves, strict=True):
        half = 1.96 * np.sqrt(2.0 / misfit.counts)
        low, high = (np.append(v, v[-1]) for v in (1 - half, 1 + half))
        axis.fill_between(misfit.edges, low, high, step="post", color=BAND, alpha=0.3, linewidth=0)
        axis.stairs(misfit.nis, misfit.edges, color=colour, linewidth=1.6, baseline=None)
        axis.set_xlabel(plot_text(f"{misfit.name} [{misfit.unit}]" if misfit.unit else misfit.name))
        axis.set_ylabel("NIS")
        axis.set_ylim(bottom=0.0)
        axis.margins(x=0.01)
    return figure

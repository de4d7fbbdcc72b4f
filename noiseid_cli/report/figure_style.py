"""How figures look and how they become files: the same bytes each time, readable on light and on dark."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from noiseid_cli.report.tables import plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK = "#1b1f24"
GRID = "#c8ccd2"
BAND = "#8a9099"
# Middle tones: a contrast of 3 or more against the page's white and against its dark ground.
METHOD_COLOURS = {
    "em": "#2277cc",
    "em-plain": "#cc5a1e",
    "alg2": "#2a8f5b",
    "alg3": "#b0509c",
    "ml": "#8c7a14",
    "batch-ml": "#1b8a98",
    "recursive-ml": "#c8414f",
    "asrukf": "#7a68d4",
    "sb-asrukf": "#6b8a1f",
    "joint-srukf": "#a96d48",
}
LineStyle = str | tuple[int, tuple[float, ...]]
LINE_STYLES: tuple[LineStyle, ...] = ("-", (0, (5, 2)), (0, (5, 2, 1, 2)), (0, (2, 1.5)))

WIDTH = 7.2
"""Width of a figure, inch."""

FARTHEST = 1e100
"""A logarithmic axis shows what lies between this and one over it."""

LONGEST = 40
"""Characters of a name in a figure."""

_RC: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.labelsize": 9.0,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "axes.facecolor": "none",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.4,
    "svg.fonttype": "path",
    **dict.fromkeys(("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color"), INK),
}


@dataclass(frozen=True)
class Plot:
    """A figure with its words.

    Attributes:
        name: stem of its files and anchor in the page.
        title: what it shows.
        caption: how to read it.
        draw: makes the figure; called when a file or a page needs it.
    """

    name: str
    title: str
    caption: str
    draw: Callable[[], Figure]

    @cached_property
    def figure(self) -> Figure:
        """The figure, drawn and laid out once, so that every file shows the same."""
        with style():
            figure = self.draw()
            if (layout := figure.get_layout_engine()) is not None:
                layout.execute(figure)
            figure.set_layout_engine("none")
        return figure

    @cached_property
    def svg(self) -> bytes:
        """The figure as SVG on white, written once for the file and the page."""
        import matplotlib
        from matplotlib.backends.backend_svg import FigureCanvasSVG

        out = io.BytesIO()
        figure = self.figure
        with style():
            matplotlib.rcParams["svg.hashsalt"] = f"noiseid-{self.name}"
            figure.set_facecolor("white")
            canvas: Any = FigureCanvasSVG(figure)
            canvas.print_svg(out, metadata={"Date": None, "Title": plain(self.title)})
        return out.getvalue()


def method_colours(labels: Sequence[str]) -> dict[str, str]:
    """A colour for each method label; known names keep theirs, others take what is free, in order of name."""
    distinct = sorted(set(labels))
    chosen = {label: METHOD_COLOURS[label] for label in distinct if label in METHOD_COLOURS}
    free = [c for c in METHOD_COLOURS.values() if c not in chosen.values()] or list(METHOD_COLOURS.values())
    others = [label for label in distinct if label not in chosen]
    return chosen | {label: free[i % len(free)] for i, label in enumerate(others)}


@contextmanager
def style() -> Iterator[None]:
    """Our settings on top of matplotlib's own defaults, whatever the user's are; for drawing and for saving."""
    import matplotlib

    with matplotlib.rc_context(), warnings.catch_warnings():
        # A name in a script that the font lacks is drawn as boxes: the tables show it right.
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        warnings.filterwarnings("ignore", message=".*Matplotlib currently does not support .* natively")
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_RC)
        yield


def panels(
    count: int, columns: int, height: float, share_y: bool = False, share_x: bool = True
) -> tuple[Figure, list[Axes]]:
    """A figure with ``count`` panels, row by row, each ``height`` inch high."""
    from matplotlib.figure import Figure

    columns = min(columns, count)
    rows = -(-count // columns)
    figure = Figure(figsize=(WIDTH, rows * height + 0.7), layout="constrained")
    axes = list(figure.subplots(rows, columns, sharex=share_x, sharey=share_y, squeeze=False).ravel())
    for axis in axes[count:]:
        axis.remove()
    # Where the last row is short, the panel above its gap shows the ticks.
    for axis in axes[max(count - columns, 0) : count]:
        axis.tick_params(labelbottom=True)
    return figure, axes[:count]


def log_axis(axis: Axes, which: Literal["x", "y"]) -> None:
    """A logarithmic axis with plain numbers, and enough of them where it spans less than two decades."""
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

    if not _leave_out_extremes(axis, which):
        return
    (axis.set_xscale if which == "x" else axis.set_yscale)("log")
    low, high = axis.get_xlim() if which == "x" else axis.get_ylim()
    side = axis.xaxis if which == "x" else axis.yaxis
    if high < 5 * low:
        side.set_major_locator(MaxNLocator(nbins=5, steps=[1, 2, 5, 10]))
    else:
        side.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 100 * low else (1.0,)))
    side.set_major_formatter(FuncFormatter(_plain_tick))
    side.set_minor_formatter(NullFormatter())


def _leave_out_extremes(axis: Axes, which: Literal["x", "y"]) -> bool:
    """Take away points that matplotlib's own arithmetic cannot put on a logarithmic axis; False if none is left."""
    found = left = False
    for line in axis.lines:
        values = np.asarray(line.get_xdata() if which == "x" else line.get_ydata(), dtype=float)
        with np.errstate(invalid="ignore"):
            far = (np.abs(values) > FARTHEST) | (np.abs(values) < 1 / FARTHEST)
        if far.any():
            found = True
            values = np.where(far, np.nan, values)
            (line.set_xdata if which == "x" else line.set_ydata)(values)
        left |= bool(np.isfinite(values).any())
    if found:
        axis.relim()
        axis.autoscale_view()
    return left or not found


def _plain_tick(value: float, _: int) -> str:
    return f"{value:g}" if 1e-4 <= value < 1e6 else f"{value:.4g}".replace("e-0", "e-").replace("e+0", "e")


def plot_text(text: str) -> str:
    """Text that matplotlib draws as it is, cut where it would crowd out the figure: $ starts no formula."""
    text = plain(text)
    text = text if len(text) <= LONGEST else text[: LONGEST - 1] + "…"
    return text.replace("$", r"\$")


def legend_above(figure: Figure, axis: Axes, columns: int = 4) -> None:
    """One legend for all panels, above them."""
    handles, labels = axis.get_legend_handles_labels()
    if labels:
        widest = max(len(label) for label in labels)
        fitting = max(1, min(columns, 100 // (widest + 8)))
        figure.legend(handles, labels, loc="outside upper left", ncols=min(fitting, len(labels)))


def svg_file(plot: Plot) -> bytes:
    """The figure as a stand-alone SVG file on white."""
    return plot.svg


def png_file(plot: Plot) -> bytes:
    """The figure as a PNG file on white, 200 dots per inch."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    out = io.BytesIO()
    with style():
        plot.figure.dpi = 200
        # The canvas itself: Figure.savefig would draw everything once more, to lay out what is laid out already.
        canvas: Any = FigureCanvasAgg(plot.figure)
        canvas.print_png(out)
    return out.getvalue()


def inline_svg(plot: Plot) -> str:
    """The figure as an SVG element for a page: ink and grid take the page's colours, ids are the figure's own."""
    text = plot.svg.decode("utf-8")
    text = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r"<title>.*?</title>", "", text, count=1, flags=re.DOTALL)
    paper = text.index('id="patch_1"')
    text = text[:paper] + text[paper:].replace("fill: #ffffff", "fill: none", 1)
    text = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{plot.name}-", text)
    text = text.replace(INK, "currentColor").replace(GRID, "var(--grid)")
    return re.sub(r"\n\s*\n+", "\n", text).strip()

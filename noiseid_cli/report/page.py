"""The report as files: one HTML page that needs nothing else, Markdown, tables and figures."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from noiseid_cli.errors import NoiseidError
from noiseid_cli.report.answer import count_sentence
from noiseid_cli.report.blocks import Block, Bullets, Code, Equations, Section
from noiseid_cli.report.figure_style import Plot, inline_svg, png_file, svg_file
from noiseid_cli.report.render_csv import csv_table
from noiseid_cli.report.render_html import html_code, html_table, html_text
from noiseid_cli.report.render_latex import latex_table
from noiseid_cli.report.render_markdown import markdown_code, markdown_table, markdown_text
from noiseid_cli.report.render_math import html_math
from noiseid_cli.report.sections import sections
from noiseid_cli.report.study import Study
from noiseid_cli.report.tables import Table, plain
from noiseid_cli.report.tidy import tidy_table

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup

FORMATS = ("html", "md", "csv", "tex", "svg", "png")


@dataclass(frozen=True)
class ReportFiles:
    """What a report wrote; a page is None where its format was not asked for."""

    folder: Path
    html: Path | None
    markdown: Path | None
    tables: tuple[Path, ...]
    figures: tuple[Path, ...]


def make_report(study: Study, folder: Path, formats: Collection[str] = FORMATS) -> ReportFiles:
    """Write a report. The same study gives the same bytes.

    Args:
        study: what to show.
        folder: where to write ``report.html``, ``report.md``, ``results.csv``, ``tables/`` and ``figures/``.
        formats: which of ``FORMATS`` to write.

    Raises:
        NoiseidError: a format is not known.
    """
    unknown = sorted(set(formats) - set(FORMATS))
    if unknown:
        raise NoiseidError(f"Unknown report format {', '.join(unknown)}: choose from {', '.join(FORMATS)}.")
    parts = sections(study)
    blocks = [block for part in parts for block in part.blocks]
    tables = [block for block in blocks if isinstance(block, Table)]
    plots = [block for block in blocks if isinstance(block, Plot)]
    written: list[Path] = []
    for kind, render in _TABLE_FILES.items():
        if kind in formats:
            written += [_write(folder / "tables" / f"{t.name}.{kind}", render(t).encode()) for t in tables]
    if "csv" in formats:
        written.insert(0, _write(folder / "results.csv", csv_table(tidy_table(study)).encode()))
    drawn: list[Path] = []
    for kind, draw in _FIGURE_FILES.items():
        if kind in formats:
            drawn += [_write(folder / "figures" / f"{p.name}.{kind}", draw(p)) for p in plots]
    linked = next((kind for kind in _FIGURE_FILES if kind in formats), None)
    html = _write(folder / "report.html", html_page(study, parts).encode()) if "html" in formats else None
    markdown = None
    if "md" in formats:
        markdown = _write(folder / "report.md", markdown_page(study, parts, linked).encode())
    return ReportFiles(folder, html, markdown, tuple(written), tuple(drawn))


_TABLE_FILES: dict[str, Callable[[Table], str]] = {"csv": csv_table, "tex": latex_table}
_FIGURE_FILES: dict[str, Callable[[Plot], bytes]] = {"svg": svg_file, "png": png_file}


def _write(path: Path, content: bytes) -> Path:
    """Write a file whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    try:
        part.write_bytes(content)
        part.replace(path)
    except BaseException:  # on a full disk, half a file would only take the space that is to be freed
        with suppress(OSError):
            part.unlink(missing_ok=True)
        raise
    return path


def lead(study: Study) -> str:
    """The line under the title."""
    return f"Experiment {study.experiment}. {count_sentence(study)}"


def html_page(study: Study, parts: list[Section]) -> str:
    """The whole report as one page, figures and styles inside."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("noiseid_cli.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
    )
    shown = [
        {"anchor": part.anchor, "heading": part.heading, "blocks": [_html_block(b) for b in part.blocks]}
        for part in parts
    ]
    page = environment.get_template("report.html.j2")
    script = _part(environment, "report.js")
    return page.render(
        title=plain(study.title),
        lead=plain(lead(study)),
        sections=shown,
        style=_part(environment, "report.css"),
        script=script,
        script_hash=b64encode(sha256(script.encode()).digest()).decode(),
    )


def _part(environment: Environment, name: str) -> Markup:
    """A file of ours that goes into the page as it is."""
    from markupsafe import Markup

    assert environment.loader is not None
    return Markup(environment.loader.get_source(environment, name)[0])


def _html_block(block: Block) -> Markup:
    """One block as HTML: its texts have been through the escaper, so that the template must not do it again."""
    from markupsafe import Markup

    if isinstance(block, Table):
        html = html_table(block)
    elif isinstance(block, Plot):
        title, caption = html_text(block.title), html_text(block.caption)
        drawing = f'<div class="drawing" role="img" aria-label="{title}" tabindex="0">{inline_svg(block)}</div>'
        caption = f"<figcaption><strong>{title}.</strong> {caption}</figcaption>"
        html = f'<figure id="figure-{html_text(block.name)}">{caption}{drawing}</figure>'
    elif isinstance(block, Bullets):
        html = "<ul>" + "".join(f"<li>{html_text(item)}</li>" for item in block.items) + "</ul>"
    elif isinstance(block, Equations):
        lines = "\n".join(f"<div>{html_math(line.mathml, line.text)}</div>" for line in block.lines)
        title = html_text(block.title)
        html = f'<h3>{title}</h3>\n<div class="equations" tabindex="0" role="group" aria-label="{title}">{lines}</div>'
    elif isinstance(block, Code):
        html = f'<pre tabindex="0">{html_code(block.text)}</pre>'
    else:
        html = f"<p>{html_text(block.text)}</p>"
    return Markup(html)


def markdown_page(study: Study, parts: list[Section], figure_kind: str | None) -> str:
    """The whole report as Markdown; figures are links to the files of the kind given, if any."""
    lines = [f"# {markdown_text(study.title)}", "", markdown_text(lead(study)), ""]
    for part in parts:
        lines += [f"## {markdown_text(part.heading)}", ""]
        for block in part.blocks:
            lines += [_markdown_block(block, figure_kind), ""]
    return "\n".join(lines).rstrip() + "\n"


def _markdown_block(block: Block, figure_kind: str | None) -> str:
    if isinstance(block, Table):
        return markdown_table(block)
    if isinstance(block, Plot):
        title = f"**{markdown_text(block.title)}**"
        link = f"![{markdown_text(block.title)}](figures/{block.name}.{figure_kind})" if figure_kind else ""
        return "\n\n".join(filter(None, [title, link, markdown_text(block.caption)]))
    if isinstance(block, Bullets):
        return "\n".join(f"- {markdown_text(item)}" for item in block.items)
    if isinstance(block, Equations):
        return f"{markdown_text(block.title)}:\n\n" + markdown_code("\n".join(line.text for line in block.lines))
    if isinstance(block, Code):
        return markdown_code(block.text)
    return markdown_text(block.text)

"""The report's files: what is written, that it is complete, and that it is the same each time."""

import base64
import hashlib
import itertools
import re
from html.parser import HTMLParser

import pytest
import report_cases

from noiseid_cli.errors import NoiseidError
from noiseid_cli.report import FORMATS, make_report, page


@pytest.fixture(scope="module")
def simulated():
    return report_cases.simulated(samples=240)


@pytest.fixture(scope="module")
def written(simulated, tmp_path_factory):
    return make_report(simulated, tmp_path_factory.mktemp("report"))


def contents(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def visible(html):
    html = re.sub(r"<(style|svg|script)\b.*?</\1>", "", html, flags=re.DOTALL)
    parts = []
    parser = HTMLParser()
    parser.handle_data = parts.append
    parser.feed(html)
    return " ".join(" ".join(parts).split())


def test_every_file_is_there(written):
    names = set(contents(written.folder))
    assert {"report.html", "report.md", "results.csv"} <= names
    tables = {
        "before-after",
        "endings",
        "std-process-noise",
        "starts",
        "scores",
        "consistency",
        "parameters",
        "datasets",
    }
    assert {f"tables/{name}.{kind}" for name in tables for kind in ("csv", "tex")} <= names
    figures = {"best-paths", "convergence", "std-process-noise", "path-error", "nis", "autocorrelation"}
    assert {n for n in names if n.startswith("figures/")} == {
        f"figures/{f}.{k}" for f in figures for k in ("svg", "png")
    }
    assert not any(name.endswith(".part") for name in names)
    listed = {p.relative_to(written.folder).as_posix() for p in (*written.tables, *written.figures)}
    assert listed | {"report.html", "report.md"} == names


def test_same_study_same_bytes(written, simulated, tmp_path):
    again = make_report(report_cases.simulated(samples=240), tmp_path)
    assert contents(again.folder) == contents(written.folder)


def test_page_is_self_contained(written):
    html = written.html.read_text()
    assert not re.search(r"""(src|srcset|action)\s*=|@import|url\((?!#)|<link""", html)
    script = re.findall(r"<script>(.*?)</script>", html, flags=re.DOTALL)
    assert len(script) == 1
    allowed = base64.b64encode(hashlib.sha256(script[0].encode()).digest()).decode()
    assert f"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{allowed}'" in html
    assert not re.search(r"fetch|XMLHttp|import\(|https?:", script[0])
    assert all(ref.startswith("#") for ref in re.findall(r'href="([^"]*)"', html))
    ids = re.findall(r'\bid="([^"]+)"', html)
    assert len(ids) == len(set(ids))
    references = set(re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', html))
    assert {a or b for a, b in references} <= set(ids)
    assert html.count("<svg ") == 6
    assert "currentColor" in html
    assert "#1b1f24" not in re.sub(r"<style>.*?</style>", "", html, count=1, flags=re.DOTALL)


def test_headings_come_in_order(written):
    headings = re.findall(r"<h2>(.*?)</h2>", written.html.read_text())
    assert headings == [
        "What does the estimate change?",
        "How large is the noise?",
        "Does the filter agree with the data?",
        "Do the starts agree?",
        "How do the methods compare?",
        "How was the estimate reached?",
        "Which data and which methods?",
        "Which model?",
        "How can this be done again?",
        "On what did it run?",
    ]
    contents = re.findall(r'<li><a href="#[a-z-]+">(.*?)</a></li>', written.html.read_text())
    assert contents == headings
    assert re.findall(r"^## (.*)$", written.markdown.read_text(), flags=re.MULTILINE) == headings


def test_both_pages_say_the_same(written):
    html, markdown = visible(written.html.read_text()), written.markdown.read_text()
    for text in ("4 of 4 units converged", "stands in for model error", "table 3.1", "noiseid run flexible"):
        assert text in html
        assert text.replace("_", "\\_") in markdown or text in markdown


@pytest.mark.parametrize(
    "formats", [c for n in range(4) for c in itertools.combinations(("html", "md", "csv", "tex"), n)]
)
def test_formats_choose_the_files(simulated, tmp_path, monkeypatch, formats):
    drawn = make_report_without_drawing(monkeypatch)
    files = make_report(simulated, tmp_path, formats)
    kinds = {p.suffix[1:] for p in tmp_path.rglob("*") if p.is_file()}
    assert kinds == set(formats)
    assert (files.html is not None, files.markdown is not None) == ("html" in formats, "md" in formats)
    assert not files.figures
    assert drawn == (["html"] * 6 if "html" in formats else [])


@pytest.mark.parametrize("kind", ["svg", "png"])
def test_markdown_links_figures_that_are_there(simulated, tmp_path, monkeypatch, kind):
    make_report_without_drawing(monkeypatch)
    files = make_report(simulated, tmp_path, ("md", kind))
    links = re.findall(r"\]\((figures/[^)]+)\)", files.markdown.read_text())
    assert len(links) == 6
    assert all((tmp_path / link).is_file() and link.endswith(kind) for link in links)
    assert {p.suffix for p in files.figures} == {f".{kind}"}


def make_report_without_drawing(monkeypatch):
    """Stand-ins for the slow part; the files themselves are tested above."""
    drawn = []
    monkeypatch.setattr(page, "inline_svg", lambda plot: drawn.append("html") or "<svg></svg>")
    monkeypatch.setattr(page, "_FIGURE_FILES", {"svg": lambda plot: b"svg", "png": lambda plot: b"png"})
    return drawn


def test_markdown_without_figures_has_no_links(simulated, tmp_path, monkeypatch):
    make_report_without_drawing(monkeypatch)
    assert "](figures" not in make_report(simulated, tmp_path, ("md",)).markdown.read_text()


def test_unknown_format_is_refused(simulated, tmp_path):
    with pytest.raises(NoiseidError, match=r"Unknown report format pdf: choose from html, md, csv, tex, svg, png\."):
        make_report(simulated, tmp_path, ("html", "pdf"))
    assert not list(tmp_path.iterdir())
    assert set(FORMATS) == {"html", "md", "csv", "tex", "svg", "png"}


def assert_no_nan(files):
    text = visible(files.html.read_text()) + files.markdown.read_text()
    assert not re.search(r"(?<![A-Za-z])(nan|-?inf)(?![A-Za-z])", text, flags=re.IGNORECASE)


def test_measured_study_without_truth(tmp_path):
    files = make_report(report_cases.measured(samples=120), tmp_path, ("html", "md", "csv"))
    text = visible(files.html.read_text())
    assert "implausible for a quantised sensor" in text
    assert text.index("implausible") < text.index("What does the estimate change")
    assert "3 rows with repeated times were dropped" in text
    assert "the covariance R of the measurement noise (qm1 [rad]" in text
    assert "true path" not in text
    assert "Do the starts agree" not in text
    assert "Means per method" not in text
    assert files.html.read_text().count("<svg ") == 5  # no path error, but the measurement noise
    assert_no_nan(files)


def test_diverged_unit_is_shown_and_counted(tmp_path):
    study = report_cases.simulated(samples=120)
    study.results[1] = report_cases.diverged(study.results[1])
    files = make_report(study, tmp_path, ("html", "md"))
    text = visible(files.html.read_text())
    assert "3 of 4 units converged (1 diverged). The others are shown, but not part of any mean." in text
    assert "The filter's state left the finite numbers" in text
    assert "Not available: the unit ended as diverged" in text
    assert_no_nan(files)


@pytest.mark.parametrize("count", [0, 1])
def test_nothing_but_failures(tmp_path, count):
    units = [report_cases.diverged(report_cases.unit("em", 0, samples=60))] * count
    files = make_report(report_cases.study(units, samples=60), tmp_path, ("html", "md", "csv"))
    text = visible(files.html.read_text())
    assert ("no unit has run yet" if count == 0 else "0 of 1 unit converged") in text
    assert_no_nan(files)


def test_many_units_stay_legible(tmp_path):
    files = make_report(report_cases.many(replicates=10, samples=60), tmp_path, ("html", "md", "svg"))
    text = visible(files.html.read_text())
    assert "34 of 40 units converged (6 diverged)" in text
    assert "2 of 40 units are drawn" in text
    assert files.html.stat().st_size < 1_000_000
    assert_no_nan(files)


def test_a_full_disk_leaves_no_half_file_of_a_report(tmp_path, monkeypatch):
    from noiseid_cli.report import page

    kept = tmp_path / "kept.md"
    kept.write_text("old")
    real = page.Path.write_bytes

    def full(path, content):
        real(path, content[:1])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(page.Path, "write_bytes", full)
    with pytest.raises(OSError, match="No space"):
        page._write(kept, b"new")
    assert [path.name for path in tmp_path.iterdir()] == ["kept.md"]
    assert kept.read_text() == "old"

"""Text stays text in every format, whatever it holds."""

import csv
import io
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
import report_cases

import noiseid_cli.report
from noiseid_cli.report import EquationFact, ParameterFact, make_report
from noiseid_cli.report.render_csv import csv_table
from noiseid_cli.report.render_html import html_table, html_text
from noiseid_cli.report.render_latex import latex_table, latex_text
from noiseid_cli.report.render_markdown import markdown_code, markdown_table, markdown_text
from noiseid_cli.report.render_math import ELEMENTS, html_math
from noiseid_cli.report.render_terminal import terminal_table
from noiseid_cli.report.tables import Column, Missing, Table, plain

TEMPLATES = Path(noiseid_cli.report.__file__).parent / "templates"

PAYLOADS = [
    "<script>alert(1)</script>",
    '"><img src=x onerror=alert(1)>',
    "' onmouseover='alert(1)",
    "</title><svg onload=alert(1)>",
    "</pre><iframe src=javascript:alert(1)>",
    "<!-- -->--><b>",
    "{{ 7 * 7 }} {% raw %}",
    "&lt;script&gt; &#60;script&#62;",
    "a | b || c",
    "a \\| b \\\\| c",
    "`code` | ``more``",
    "[x](javascript:alert(1)) ![i](http://example.com/i.png)",
    "*bold* _it_ ~~gone~~ # head $x$",
    "- item",
    "1. item",
    "=cmd|' /C calc'!A0",
    "+1+1",
    "-2+3",
    "@SUM(A1)",
    "\t=1+1",
    " =1+1",
    "＝1+1",
    '"quoted", comma; semicolon',
    "\x1b[31mred\x1b[0m\x1b]0;title\x07",
    "bell \a back \b nul \0 del \x7f c1 \x9b31m",
    "first\r\nsecond\nthird\vfourth\u2028fifth",
    "\u202eright to left\u2066",
    "lone \ud800 surrogate",
    "\\input{/etc/passwd} \\write18{ls} \\end{tabular}",
    "100 % & $x_1^2$ #1 ~ {brace} \\\\",
    "--- ``quotes'' [5cm] *",
    "Ångström µ ² Ω θ 漢字",
]


def table(text):
    return Table("t", text, text, (Column(text, text), Column("value", "m")), ((text, 1.5), (text, Missing(text))))


class Nodes(HTMLParser):
    """Collects tags, attributes and text."""

    def __init__(self):
        super().__init__(convert_charrefs=True)
        self.tags, self.attributes, self.text = set(), [], []

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.attributes += attrs

    def handle_data(self, data):
        self.text.append(data)


def parse(html):
    nodes = Nodes()
    nodes.feed(html)
    nodes.close()
    return nodes


def assert_harmless(html):
    nodes = parse(html)
    assert not nodes.tags & {"script", "img", "iframe", "object", "embed", "link", "base", "form", "b"}
    for name, value in nodes.attributes:
        assert not name.startswith("on"), name
        assert name not in ("src", "srcset", "action"), name
        if name.endswith("href"):
            assert value.startswith("#"), value
    return nodes


def no_commands(text):
    return not re.search(r"[\x00-\x09\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]", text)


@pytest.mark.parametrize("payload", PAYLOADS)
def test_html_shows_the_text_and_nothing_else(payload):
    html = html_table(table(payload))
    nodes = assert_harmless(html)
    assert nodes.tags <= {
        "figure", "figcaption", "strong", "div", "table", "thead", "tbody", "tr", "th", "td", "span", "sup", "ol", "li"
    }  # fmt: skip
    assert plain(payload) in "".join(nodes.text)
    assert no_commands(html)
    assert "".join(parse(f"<p>{html_text(payload)}</p>").text) == plain(payload)


@pytest.mark.parametrize("payload", PAYLOADS)
@pytest.mark.parametrize("around", ["{}", "<mi>{}</mi>", "<mrow><mi {}>x</mi></mrow>", "<mtext>{}", "<{}></{}>"])
def test_equations_hold_nothing_but_an_equation(payload, around):
    html = html_math(around.replace("{}", payload), payload)
    nodes = assert_harmless(html)
    assert nodes.tags <= {"math", "code", *ELEMENTS}
    assert [name for name, _ in nodes.attributes if name not in ("display", "aria-label")] == []
    assert no_commands(html)


def test_an_equation_is_drawn_as_it_is_given():
    assert html_math("<msup><mi>a&lt;</mi><mn>2</mn></msup>", "a²") == (
        '<math display="block" aria-label="a²"><msup><mi>a&lt;</mi><mn>2</mn></msup></math>'
    )
    assert html_math("", "a < b") == "<code>a &lt; b</code>"
    for broken in (
        "<mi>a",
        "</mi>",
        "<mrow><mi>a</mrow></mi>",
        "<script>a</script>",
        "<!-- -->",
        "<?x?>",
        "<mi>a</mi><a>b</a>",
    ):
        assert html_math(broken, "a") == "<code>a</code>"


def unescaped_pipes(line):
    return len(re.findall(r"\|", line))


@pytest.mark.parametrize("payload", PAYLOADS)
def test_markdown_rows_keep_their_columns(payload):
    text = markdown_table(table(payload))
    rows = [line for line in text.split("\n") if line.startswith("|")]
    assert len(rows) == 4
    # No pipe survives in a cell, not even an escaped one: any renderer counts the same columns.
    assert [unescaped_pipes(row) for row in rows] == [3] * 4
    assert no_commands(text)
    assert not parse(text).tags
    assert not parse(markdown_text(payload)).tags
    assert not re.match(r"\s*([-+=#>]|\d+[.)])(\s|$|=|\d)", markdown_text(payload)), markdown_text(payload)


@pytest.mark.parametrize("payload", PAYLOADS)
def test_markdown_code_cannot_be_left(payload):
    assert all(line.startswith("    ") for line in markdown_code(payload).split("\n"))
    assert no_commands(markdown_code(payload))


@pytest.mark.parametrize("payload", PAYLOADS)
def test_latex_runs_no_command_of_the_text(payload):
    text = latex_text(payload)
    # Take away what the escaper writes on purpose: what is left must hold no character that TeX acts on.
    left = re.sub(
        r"\\(text[a-z]+|dots)\{\}|\\[{}$&#%_]|'\{\}|(?<=-)\{\}(?=-)|^\{\}(?=\s*[\[*])|\$(\^2|\^3|-|\\[A-Za-z]+|\^\\circ)\$",
        "",
        text,
    )
    assert not re.search(r"[\\{}$&#%_^~<>|\"`']", left), left
    assert "--" not in text.replace("–", "")
    assert not text.lstrip().startswith(("[", "*"))
    rows = [line for line in latex_table(table(payload)).split("\n") if line.endswith(r" \\")]
    assert len(rows) == 3
    assert [len(re.findall(r"(?<!\\)&", row)) for row in rows] == [1] * 3
    assert no_commands(latex_table(table(payload)))


@pytest.mark.parametrize("payload", PAYLOADS)
def test_csv_cells_are_never_formulas(payload):
    text = csv_table(table(payload))
    rows = list(csv.reader(io.StringIO(text)))
    assert [len(row) for row in rows] == [2] * 3
    for row in rows:
        for cell in row:
            assert not cell.lstrip().startswith(("=", "+", "-", "@", "＝", "＋", "－", "＠"))
    assert rows[1][0] in (plain(payload), f"'{plain(payload)}")
    assert no_commands(text)


@pytest.mark.parametrize("payload", PAYLOADS)
def test_terminal_gets_no_command(payload):
    assert no_commands(terminal_table(table(payload)))


def test_negative_numbers_stay_numbers_in_csv():
    numbers = Table("t", "", "", (Column("a"), Column("b")), ((-1.5e-12, -3),))
    assert csv_table(numbers) == "a,b\n-1.5e-12,-3\n"


def test_a_whole_report_of_payloads(tmp_path):
    """Every text that a study carries is a payload; names of figures' panels too."""
    everything = " ".join(PAYLOADS)
    result = report_cases.unit("em", 0, samples=120)
    names = tuple((text, everything[:40], text) for text in PAYLOADS[:4])
    estimate = replace(
        result.estimate,
        method=everything,
        reason=everything,
        safeguards=tuple(PAYLOADS),
        settings=dict.fromkeys(PAYLOADS, everything),
    )
    result = replace(
        result,
        unit=everything,
        method_label=everything,
        estimate=estimate,
        noise_names=names,
        output_names=tuple((text, "$", text) for text in PAYLOADS[22:26]),
    )
    study = report_cases.study([result], samples=120)
    study = replace(
        study,
        title=everything,
        experiment=everything,
        environment=dict.fromkeys(PAYLOADS, everything),
        reproduce=PAYLOADS,
        warnings=PAYLOADS,
        citations=PAYLOADS,
        datasets=[replace(study.datasets[0], origin=everything, notes=tuple(PAYLOADS), performance_unit="$^|")],
        model=replace(
            study.model,
            name=everything,
            description=everything,
            equations=tuple(EquationFact("dynamics", text, mathml) for text in PAYLOADS[:9] for mathml in PAYLOADS),
            parameters=tuple(ParameterFact(t, 1.0, t, t, t) for t in PAYLOADS),
        ),
    )
    files = make_report(study, tmp_path, ("html", "md", "csv", "tex", "svg"))
    html = files.html.read_text()
    ours = f"<script>{(TEMPLATES / 'report.js').read_text()}</script>"
    assert html.count(ours) == 1
    nodes = assert_harmless(html.replace(ours, ""))
    assert {"svg", "table", "pre"} <= nodes.tags
    assert PAYLOADS[0] in "".join(nodes.text)
    for path in (files.html, files.markdown, *files.tables, *files.figures):
        assert no_commands(path.read_text()), path
    page = files.html.read_text()
    assert page.count("<style") == 1 + page.count("<svg ")
    for path in files.figures:
        assert not parse(path.read_text()).tags & {"script", "image", "foreignobject"}

"""The HTML report in a real browser: it opens without a complaint, fits, sorts, copies, and can be read in the dark."""

import itertools
import sys
from pathlib import Path

import chromium
import pytest

from noiseid_cli.report import make_report

sys.path.append(str(Path(__file__).parents[1] / "report"))
import report_cases

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(
        chromium.found() is None,
        reason="no browser: install Chromium or Chrome, or name one in NOISEID_BROWSER",
    ),
]


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """The page of a simulated study, with a warning in it."""
    study = report_cases.simulated(samples=240)
    study.warnings.append("This is a warning.")
    return make_report(study, tmp_path_factory.mktemp("report"), ("html",)).html


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    started = chromium.Chromium(tmp_path_factory.mktemp("profile"))
    yield started
    started.close()


@pytest.fixture
def page(browser, report):
    browser.show(1280)
    browser.open(report)
    return browser


def test_the_page_opens_without_a_word_and_asks_for_nothing(page, report):
    said = [
        e
        for e in page.events
        if e["method"] in ("Log.entryAdded", "Runtime.consoleAPICalled", "Runtime.exceptionThrown")
    ]
    assert said == []
    asked = {e["params"]["request"]["url"] for e in page.events if e["method"] == "Network.requestWillBeSent"}
    assert asked == {report.as_uri()}
    assert page.ask("document.compatMode") == "CSS1Compat"


def test_no_other_script_runs(page):
    page.ask(
        "{ const s = document.createElement('script'); s.textContent = 'window.ran = 1'; document.body.append(s); }"
    )
    assert page.ask("window.ran === undefined")


@pytest.mark.parametrize("width", [320, 400, 800, 1280, 1920])
def test_nothing_is_wider_than_the_window(page, width):
    page.show(width)
    assert page.ask("document.documentElement.scrollWidth") <= width
    wide = """[...document.querySelectorAll('body *')].filter(e => e.getBoundingClientRect().right > innerWidth + 1
        && !e.closest('.scroll, .drawing, .equations, pre')).map(e => e.outerHTML.slice(0, 90))"""
    assert page.ask(wide) == []


COLOURS = """(() => {
  const rgb = s => s.match(/[\\d.]+/g).slice(0, 3).map(Number);
  const ground = e => { for (; e; e = e.parentElement) { const c = getComputedStyle(e).backgroundColor;
    if (!/, 0\\)$|transparent/.test(c)) return rgb(c); } return [255, 255, 255]; };
  return [...document.querySelectorAll('h1, h2, p, li, a, th, td, figcaption, button, pre, mi, mo, .unit')]
    .map(e => [e.tagName + '.' + e.className, rgb(getComputedStyle(e).color), ground(e)]);
})()"""


def contrast(one, other):
    """Contrast of WCAG 2."""
    lights = []
    for colour in (one, other):
        parts = [c / 255 for c in colour]
        linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
        lights.append(sum(w * v for w, v in zip((0.2126, 0.7152, 0.0722), linear, strict=True)))
    return (max(lights) + 0.05) / (min(lights) + 0.05)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_stands_out(page, scheme):
    page.show(1280, scheme)
    found = page.ask(COLOURS)
    assert {name.split(".")[0] for name, _, _ in found} >= {"H1", "P", "TD", "TH", "A", "BUTTON", "mi"}
    assert [(name, ink, ground) for name, ink, ground in found if contrast(ink, ground) < 4.5] == []
    grounds = {tuple(ground) for _, _, ground in found}
    assert all((sum(ground) > 600) == (scheme == "light") for ground in grounds)


# A marker takes its colours from its definition, where they are not its own.
DRAWN = """[...new Set([...document.querySelectorAll('.drawing svg :is(path, use, text)')]
  .filter(e => !e.closest('defs, clipPath'))
  .flatMap(e => ['fill', 'stroke'].filter(p => e.tagName !== 'use' || e.style[p]).map(p => getComputedStyle(e)[p]))
  .filter(c => c !== 'none'))]"""


@pytest.mark.parametrize(("scheme", "ink"), [("light", "rgb(27, 31, 36)"), ("dark", "rgb(228, 231, 235)")])
def test_figures_take_the_ink_of_the_page(page, scheme, ink):
    page.show(1280, scheme)
    colours = page.ask(DRAWN)
    assert ink in colours
    # Nothing is left in the black that SVG draws in where no colour is given, nor in the ink of the other scheme.
    assert {"rgb(0, 0, 0)", "rgb(27, 31, 36)", "rgb(228, 231, 235)"} & set(colours) == {ink}


def column(page, name, heading):
    return page.ask(
        f"""(() => {{ const t = document.querySelector('#table-{name} table');
        const j = [...t.tHead.rows[0].cells].findIndex(c => c.textContent.startsWith('{heading}'));
        return [...t.tBodies[0].rows].map(r => r.cells[j].dataset.value ?? r.cells[j].textContent); }})()"""
    )


def click(page, name, heading):
    page.ask(
        f"[...document.querySelectorAll('#table-{name} thead button')]"
        f".find(b => b.textContent.startsWith('{heading}')).click()"
    )


def test_a_click_on_a_heading_sorts(page):
    before = column(page, "std-process-noise", "Estimate")
    click(page, "std-process-noise", "Estimate")
    assert [float(v) for v in column(page, "std-process-noise", "Estimate")] == sorted(map(float, before))
    assert page.ask("document.querySelector('#table-std-process-noise [aria-sort]').ariaSort") == "ascending"
    click(page, "std-process-noise", "Estimate")
    assert [float(v) for v in column(page, "std-process-noise", "Estimate")] == sorted(map(float, before), reverse=True)
    click(page, "std-process-noise", "Noise")
    names = column(page, "std-process-noise", "Noise")
    assert names == sorted(names)
    assert page.ask("document.querySelectorAll('#table-std-process-noise [aria-sort]').length") == 1
    click(page, "std-process-noise", "Noise")
    click(page, "std-process-noise", "Noise")
    assert column(page, "std-process-noise", "Estimate") == before


def test_a_table_is_copied_in_full_precision(page):
    page.ask("Object.defineProperty(navigator, 'clipboard', {value: {writeText: async t => { window.copied = t; }}})")
    page.ask("document.querySelector('#table-std-process-noise .copy').click()")
    lines = [line.split("\t") for line in page.ask("window.copied").split("\n")]
    study = report_cases.simulated(samples=240)
    end = study.results[0].estimate.final.Q[0, 0] ** 0.5
    assert lines[0][:5] == ["Unit", "Noise", "In", "Start", "Estimate"]
    assert lines[1][0] == "em/start-0"
    assert float(lines[1][4]) == end
    assert {len(line) for line in lines} == {len(lines[0])}


def test_copying_works_without_the_clipboard_of_the_page(page):
    page.ask("""(() => { Object.defineProperty(navigator, 'clipboard', {value: undefined});
        document.execCommand = what => { window.copied = what + ': ' + document.activeElement.value; return true; };
        document.querySelector('.code .copy').click(); })()""")
    assert page.ask("new Promise(r => setTimeout(() => r(window.copied), 50))").startswith("copy: noiseid init")
    assert page.ask("document.querySelectorAll('textarea').length") == 0


def test_equations_are_set(page):
    assert page.ask("document.querySelector('math').getBoundingClientRect().height") > 10
    assert page.ask("document.querySelector('math').ariaLabel") == "T = k·x"


def test_everything_has_a_name_to_be_read_aloud(page):
    nameless = """[...document.querySelectorAll('button, [role=img], [role=region], [role=group], nav, math')]
        .filter(e => !(e.ariaLabel || e.textContent.trim())).length"""
    assert page.ask(nameless) == 0
    assert page.ask("document.querySelectorAll('th:not([scope])').length") == 0
    assert page.ask("document.querySelectorAll('h1').length") == 1
    levels = page.ask("[...document.querySelectorAll('h1, h2, h3')].map(h => Number(h.tagName[1]))")
    assert all(b - a <= 1 for a, b in itertools.pairwise(levels))


def test_links_of_the_contents_lead_somewhere(page):
    assert page.ask("[...document.querySelectorAll('nav a')].every(a => document.querySelector(a.hash))")
    order = "document.querySelector('.warnings').compareDocumentPosition(document.querySelector('nav')) & 4"
    assert page.ask(order) == 4  # the warnings come first


def test_paper_shows_everything_and_no_buttons(page):
    page.show(700, "dark", media="print")
    shown = "[...document.querySelectorAll('nav, .copy')].every(e => getComputedStyle(e).display === 'none')"
    assert page.ask(shown)
    assert page.ask("[...document.querySelectorAll('.scroll')].every(e => getComputedStyle(e).maxHeight === 'none')")
    assert page.ask("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"

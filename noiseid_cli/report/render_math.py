"""Equations as MathML inside HTML: only elements and letters that an equation is made of pass."""

from __future__ import annotations

from html.parser import HTMLParser

from noiseid_cli.report.render_html import html_text

ELEMENTS = frozenset(
    {"mfrac", "mi", "mn", "mo", "mover", "mroot", "mrow", "msqrt", "msub", "msubsup", "msup", "mtable", "mtd", "mtext"}
    | {"mtr", "munder"}
)
"""Presentation elements without any that link or load; attributes are dropped, all of them."""


def html_math(mathml: str, text: str) -> str:
    """One equation as a ``math`` element, or as its text where there is no MathML that can be trusted.

    Args:
        mathml: presentation MathML, without the ``math`` element.
        text: the same equation on one line: what is read aloud, and what stands in for it.
    """
    drawn = _Equation().rewrite(mathml) if mathml else None
    if drawn is None:
        return f"<code>{html_text(text)}</code>"
    return f'<math display="block" aria-label="{html_text(text)}">{drawn}</math>'


class _Equation(HTMLParser):
    """Writes anew what it reads, so that nothing of the source is in the page but known elements and escaped text."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.out: list[str] = []
        self.open: list[str] = []
        self.sound = True

    def rewrite(self, source: str) -> str | None:
        """The equation, or None if it holds anything else than an equation does."""
        self.feed(source)
        self.close()
        return "".join(self.out) if self.sound and not self.open else None

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.sound &= tag in ELEMENTS
        self.open.append(tag)
        self.out.append(f"<{tag}>")

    def handle_endtag(self, tag: str) -> None:
        self.sound &= bool(self.open) and self.open.pop() == tag
        self.out.append(f"</{tag}>")

    def handle_data(self, data: str) -> None:
        self.out.append(html_text(data))

    def handle_comment(self, data: str) -> None:
        self.sound = False

    def handle_decl(self, decl: str) -> None:
        self.sound = False

    def handle_pi(self, data: str) -> None:
        self.sound = False

    def unknown_decl(self, data: str) -> None:
        self.sound = False

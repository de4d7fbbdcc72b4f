"""What a report is made of: sections under headings, and the blocks that stand in them."""

from __future__ import annotations

from dataclasses import dataclass

from noiseid_cli.report.figure_style import Plot
from noiseid_cli.report.study import EquationFact
from noiseid_cli.report.tables import Table


@dataclass(frozen=True)
class Paragraph:
    """Text in one paragraph."""

    text: str


@dataclass(frozen=True)
class Bullets:
    """A list of sentences."""

    items: tuple[str, ...]


@dataclass(frozen=True)
class Code:
    """Lines to be shown exactly as they are."""

    text: str


@dataclass(frozen=True)
class Equations:
    """Equations under one title, set as on paper where the format can."""

    title: str
    lines: tuple[EquationFact, ...]


Block = Paragraph | Bullets | Code | Equations | Table | Plot


@dataclass(frozen=True)
class Section:
    """A heading, the anchor to it, and what stands below."""

    anchor: str
    heading: str
    blocks: tuple[Block, ...]

"""Content of the report, section by section; templates/ has its form, one HTML file with its style.

It is readable on a phone and in dark mode, and has no script.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import Any

from rf_exp.ablation import formats
from rf_exp.ablation.tables.table import CLEAN, Difference, Line, Score, Share, Table, Text
from rf_exp.artifacts import render_template

MAX_ABREAST = 5  # columns of figures that a page of 1400 pixels holds
TEMPLATE = Path(__file__).with_name("templates") / "report.html"


@dataclass(frozen=True)
class Panel:
    """A card: a plot, a picture or a strip of pictures, with a caption below."""

    title: str
    svg: str = ""  # markup
    picture: str = ""  # its URL, which may be a data URL
    strip: tuple[str, ...] = ()  # pictures side by side
    caption: str = ""
    film: str = ""  # its URL relative to the report


@dataclass(frozen=True)
class Section:
    """A section of the page. Shows the parts that it has, in this order; left out if it has none."""

    anchor: str
    heading: str
    command: str = ""  # makes first results, where there are none
    tiles: tuple[tuple[str, str], ...] = ()  # (large figure, its meaning)
    lead: str = ""
    table: Mapping[str, Any] | None = None  # as returned by `layout`
    titles: tuple[str, ...] = ()
    rows: Sequence[tuple[str, ...]] = ()  # of texts, below `titles`
    panels: tuple[Panel, ...] = ()
    recordings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    collapsed: tuple[tuple[str, str], ...] = ()  # title, text

    @property
    def has_content(self) -> bool:
        parts = self.tiles, self.table, self.rows, self.panels, self.recordings, self.notes, self.collapsed
        return any(parts)


def document(title: str, source: str, sections: list[Section]) -> str:
    """The page, with links to its sections at the top. `source` is the paper that ours is compared to."""
    nonempty = [section for section in sections if section.has_content]
    return render_template(TEMPLATE, title=title, source=source, sections=nonempty)


def layout(table: Table) -> dict[str, Any]:
    """The layout of a table on the page.

    Violations are in the cell of the figure with the same attempts. Columns that do not fit side by side go
    on below, and those of long texts follow in a collapsed table of their own. A note names what was not
    measured.
    """
    table = table.without_empty
    long_columns = [i for i in range(len(table.columns)) if formats.is_long(table, i)]
    standalone_kinds = (Text, Difference, Score, Share)  # kinds without the paper's figures and violations
    texts = [
        i
        for i, column in enumerate(table.columns)
        if column.kind in standalone_kinds and i not in long_columns
    ]
    figures = [index for index, _ in table.compared]
    block_count = max(1, ceil(len(figures) / MAX_ABREAST))
    per_block = ceil(len(figures) / block_count)
    titles = [line.title for line in table.lines]

    def name(line: Line) -> str:
        """The title of a line, with its first text where several lines have the same title."""
        ambiguous, first = titles.count(line.title) > 1, line.cells[0]
        return f"{line.title}, {first.value}" if ambiguous and isinstance(first, Text) else line.title

    return {
        "table": table,
        "blocks": [
            sorted([*texts, *figures[k * per_block : (k + 1) * per_block]]) for k in range(block_count)
        ],  # abreast
        "violations_of": dict(table.compared),  # column of figures -> that of its violations
        "long": [table.columns[i] for i in long_columns],
        "long_rows": [
            [name(line), *(line.cells[i].value for i in long_columns)] for line in table.lines
        ],  # long texts
        "notes": formats.notes(table),
        "clean": CLEAN,
    }

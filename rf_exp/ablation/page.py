"""What the report shows, section by section; templates/ says how: one HTML file with its style.

It is readable on a phone and in dark mode, and has no script.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import Any

from rf_exp.ablation import formats
from rf_exp.ablation.tables.table import CLEAN, Difference, Line, Score, Share, Table, Text
from rf_exp.artifacts import rendered

ABREAST = 5  # columns of figures that a page of 1400 pixels holds
TEMPLATE = Path(__file__).with_name("templates") / "report.html"


@dataclass(frozen=True)
class Panel:
    """A card: a plot, a picture or several in a strip, with words below."""

    title: str
    svg: str = ""  # markup
    picture: str = ""  # where it is; or itself, as a data URL
    strip: tuple[str, ...] = ()  # pictures side by side
    caption: str = ""
    film: str = ""  # where it is, as seen from the report


@dataclass(frozen=True)
class Section:
    """A part of the page. It shows whatever it has, in this order, and is left out where it has nothing."""

    anchor: str
    heading: str
    command: str = ""  # that makes first results, where there are none
    tiles: tuple[tuple[str, str], ...] = ()  # large figures, each with what it is
    lead: str = ""
    table: Mapping[str, Any] | None = None  # as it is `laid`
    titles: tuple[str, ...] = ()
    rows: Sequence[tuple[str, ...]] = ()  # of texts, below `titles`
    panels: tuple[Panel, ...] = ()
    recordings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    folded: tuple[tuple[str, str], ...] = ()  # title, text

    @property
    def shown(self) -> bool:
        held = self.tiles, self.table, self.rows, self.panels, self.recordings, self.notes, self.folded
        return any(held)


def document(title: str, source: str, sections: list[Section]) -> str:
    """The page, each section reachable from the top. `source` says which paper ours is compared to."""
    shown = [section for section in sections if section.shown]
    return rendered(TEMPLATE, title=title, source=source, sections=shown)


def laid(table: Table) -> dict[str, Any]:
    """A table laid out for a page.

    Violations stand in the field of the figure that they are of. More columns than fit side by side go on
    below, and those of long texts follow in a table of their own that is folded away. A note names what was
    not measured.
    """
    table = table.folded
    long = [i for i in range(len(table.columns)) if formats.is_long(table, i)]
    alone = (Text, Difference, Score, Share)  # what the paper has no figure of, and no violations
    texts = [i for i, column in enumerate(table.columns) if column.kind in alone and i not in long]
    figures = [index for index, _ in table.compared]
    rows = max(1, ceil(len(figures) / ABREAST))
    each = ceil(len(figures) / rows)
    titles = [line.title for line in table.lines]

    def name(line: Line) -> str:
        """Lines of one title are told apart by their first text."""
        several, first = titles.count(line.title) > 1, line.cells[0]
        return f"{line.title}, {first.value}" if several and isinstance(first, Text) else line.title

    return {
        "table": table,
        "blocks": [sorted([*texts, *figures[k * each : (k + 1) * each]]) for k in range(rows)],  # abreast
        "after": dict(table.compared),  # column of figures -> that of its violations
        "long": [table.columns[i] for i in long],
        "told": [[name(line), *(line.cells[i].value for i in long)] for line in table.lines],  # in full
        "notes": formats.notes(table),
        "clean": CLEAN,
    }

"""What the report shows, section by section; templates/ says how: one HTML file with its style.

It is readable on a phone and in dark mode, and has no script.
"""

from dataclasses import dataclass
from math import ceil
from pathlib import Path

from rf_exp.ablation import formats
from rf_exp.ablation.tables.table import CLEAN, Column, Difference, Score, Table, Text
from rf_exp.artifacts import rendered

ABREAST = 5  # columns of figures that a page of 1400 pixels holds
TEMPLATE = Path(__file__).with_name("templates") / "report.html"


@dataclass(frozen=True)
class Tile:
    """A large figure with what it is."""

    value: str
    what: str


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
class Texts:
    """A table of texts."""

    heading: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Laid:
    """A table laid out for a page.

    Violations stand in the field of the figure that they are of. More columns than fit side by side go on
    below, and those of long texts follow in a table of their own that is folded away.
    """

    table: Table
    blocks: tuple[tuple[int, ...], ...]  # columns that are side by side
    after: dict[int, int | None]  # column of figures -> that of its violations
    long: tuple[Column, ...]
    told: tuple[tuple[str, ...], ...]  # title and long texts of each line
    notes: tuple[str, ...]
    clean: str = CLEAN


@dataclass(frozen=True)
class Section:
    """A part of the page. It shows whatever it has, in this order, and is left out where it has nothing."""

    anchor: str
    heading: str
    command: str = ""  # that makes first results, where there are none
    tiles: tuple[Tile, ...] = ()
    lead: str = ""
    table: Laid | None = None
    texts: Texts | None = None
    panels: tuple[Panel, ...] = ()
    recordings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    folded: tuple[tuple[str, str], ...] = ()  # title, text

    @property
    def shown(self) -> bool:
        return any(
            [self.tiles, self.table, self.texts, self.panels, self.recordings, self.notes, self.folded]
        )


def document(title: str, source: str, sections: list[Section]) -> str:
    """The page, each section reachable from the top. `source` says which paper ours is compared to."""
    shown = [section for section in sections if section.shown]
    return rendered(TEMPLATE, title=title, source=source, sections=shown)


def laid(table: Table) -> Laid:
    """Caption, table and notes, ready for the page."""
    long = [i for i in range(len(table.columns)) if formats.is_long(table, i)]
    alone = (Text, Difference, Score)  # what the paper has no figure of, and no violations
    texts = [i for i, column in enumerate(table.columns) if column.kind in alone and i not in long]
    figures = [index for index, _ in table.compared]
    rows = max(1, ceil(len(figures) / ABREAST))
    each = ceil(len(figures) / rows)
    told = (
        (line.title, *(cell.value for i in long if isinstance(cell := line.cells[i], Text)))
        for line in table.lines
    )
    return Laid(
        table,
        tuple(tuple(sorted([*texts, *figures[k * each : (k + 1) * each]])) for k in range(rows)),
        dict(table.compared),
        tuple(table.columns[i] for i in long),
        tuple(told) if long else (),
        tuple(formats.notes(table)),
    )

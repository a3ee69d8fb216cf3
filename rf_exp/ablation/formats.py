"""Formats of a table: Markdown, CSV, LaTeX and the terminal.

Success at the end, success without a violation and violations are shown alike. In Markdown and LaTeX a
column of figures becomes two, ours and the paper's; violations, which the paper does not count, have one.
On the terminal each column is a table of its own, narrow enough for 80 characters; a table without figures
that the paper has too is transposed there, into a table for each title with its lines side by side.
"""

import csv
import io
from collections.abc import Callable, Iterator
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table as Grid
from rich.text import Text as Words

from rf_exp.ablation.tables.table import (
    CLEAN,
    MISSING,
    Cell,
    Column,
    Difference,
    Length,
    Line,
    Rate,
    Score,
    Table,
    Text,
    Violations,
    escape_latex,
)
from rf_exp.artifacts import write_text
from rf_exp.errors import StageError
from rf_exp.texts import markdown as marked

LONG_TEXT = 60  # characters; columns with longer texts wrap in LaTeX and are collapsed in the report
TITLE_WIDTH = 18  # characters of a row's title on the terminal, where longer ones wrap
CSV_FIELDS = (
    *("table", "row", "column", "unit", "status", "value", "low", "high", "n"),
    *("success_paper", "paper", "version", "note", "mean_violations", "clean", "clean_low", "clean_high"),
    "p",
)


def notes(table: Table) -> list[str]:
    """The notes of the table, then those of its cells with row and column.

    Violations are left out: they are of the same attempts as the figure before them, whose note suffices.
    """
    cell_notes = [
        f"{line.title}, {column.title}: {cell.note}."
        for line in table.lines
        for column, cell in zip(table.columns, line.cells, strict=True)
        if isinstance(cell, Rate | Length | Difference | Score) and cell.note
    ]
    return [*table.notes, *cell_notes]


def grid(
    table: Table, format_cell: Callable[[Cell], str], escape: Callable[[str], str]
) -> tuple[list[str], list[list[str]]]:
    """Heading and rows, formatted by `format_cell` and `escape`; the paper has columns of its own."""
    heading = [table.heading]
    for column in table.columns:
        heading += [column.title, "paper"] if column.compared else [column.title]
    rows = []
    for line in table.lines:
        row = [escape(line.title)]
        for cell in line.cells:
            row += (
                [format_cell(cell), escape(paper_figure(cell))]
                if isinstance(cell, Rate | Length)
                else [format_cell(cell)]
            )
        rows.append(row)
    return [escape(title) for title in heading], rows


def paper_figure(cell: Rate | Length) -> str:
    """The paper's figure in the unit of ours; empty where it has none."""
    return "" if cell.paper is None else cell.number(cell.paper)


def is_long(table: Table, index: int) -> bool:
    """Whether a column holds texts longer than `LONG_TEXT`."""
    cells = (line.cells[index] for line in table.lines)
    return any(isinstance(cell, Text) and len(cell.value) > LONG_TEXT for cell in cells)


def markdown(table: Table) -> str:
    heading, rows = grid(table, lambda cell: cell.markdown(), marked.cell)
    title, caption = marked.text(table.title), marked.text(table.caption)
    lines = [f"## {title}", "", caption, "", marked.table(heading, rows)]
    lines += ["", *(f"- {marked.text(note)}" for note in notes(table))]
    return "\n".join(lines).rstrip() + "\n"


def tidy_csv(table: Table) -> str:
    """CSV with a line per cell and unformatted numbers: rates in [0, 1], lengths in control steps."""
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, CSV_FIELDS, lineterminator="\n")
    writer.writeheader()
    for line in table.lines:
        for column, cell in zip(table.columns, line.cells, strict=True):
            position = {"table": table.name, "row": line.key, "column": column.key, "unit": cell.unit}
            writer.writerow(position | cell.csv())
    return buffer.getvalue()


def latex(table: Table) -> str:
    heading, rows = grid(table, lambda cell: cell.latex(), escape_latex)
    aligned = "l"
    for index, column in enumerate(table.columns):
        aligned += "p{4cm}" if is_long(table, index) else "ll" if column.compared else "l"
    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{escape_latex(table.caption)}}}",
        rf"\label{{tab:{table.name}}}",
        rf"\begin{{tabular}}{{{aligned}}}",
        r"\toprule",
        " & ".join(heading) + r" \\",
        r"\midrule",
        *(" & ".join(row) + r" \\" for row in rows),
        r"\bottomrule",
        r"\end{tabular}",
        *(rf"\par\footnotesize {escape_latex(note)}" for note in notes(table)),
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"


def write(table: Table, folder: Path) -> list[Path]:
    """Writes `<name>.md`, `.csv` and `.tex` to the folder; returns the paths. Raises StageError."""
    texts = {"md": markdown(table), "csv": tidy_csv(table), "tex": latex(table)}
    paths = [folder / f"{table.name}.{suffix}" for suffix in texts]
    try:
        for path, text in zip(paths, texts.values(), strict=True):
            write_text(path, text)
    except OSError as error:
        raise StageError(f"cannot write table {table.name} to {folder}: {error.strerror or error}") from error
    return paths


def show(table: Table, console: Console, printed: set[str] | None = None) -> None:
    """Prints a table: for each column of figures one that fits 80 characters, then the notes.

    Omits texts, except those that tell rows of one title apart, and lines and columns without figures. Omits
    the notes in `printed`, printed with other tables, and adds those of this one.
    """
    printed = set[str]() if printed is None else printed
    table = table.without_empty
    console.print(Words(f"\n{table.title}", style="bold"))
    for index, violations_index in table.compared:
        title, cells = table.columns[index].title, [line.cells[index] for line in table.lines]
        if any(isinstance(cell, Rate | Length) and not cell.missing for cell in cells):
            console.print(
                Words(f"\n{title}", style="italic"),
                _column_grid(table, index, violations_index),
                sep="\n",
                end="",
            )
        else:
            console.print(Words.assemble((f"\n{title}", "italic"), f": {MISSING}"))
    if not table.compared:
        for title, heading, rows in transposed(table, lambda cell: cell.markdown().replace("**", "")):
            rich_table = Grid(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
            for each in heading:
                rich_table.add_column(Words(each), overflow="fold")
            for row in rows:
                rich_table.add_row(*map(Words, row))
            console.print(Words(f"\n{title}", style="italic"), rich_table, sep="\n", end="")
    for note in notes(table):
        if note not in printed:
            console.print(Words(f"- {note}"), soft_wrap=False)
        printed.add(note)


def transposed(
    table: Table, text_of: Callable[[Cell], str]
) -> Iterator[tuple[str, list[str], list[list[str]]]]:
    """Yields (title, heading, rows) for the lines of a title: a column per line, named in its first cell."""
    for title in dict.fromkeys(line.title for line in table.lines):
        lines = [line for line in table.lines if line.title == title]
        heading, *rows = (
            [column.title, *(text_of(line.cells[index]) for line in lines)]
            for index, column in enumerate(table.columns)
        )
        yield title, heading, rows


def _column_grid(table: Table, index: int, violations_index: int | None) -> Grid:
    """One column as a table: our figures, rates without a violation, violations, the paper's figures."""
    is_rate, titles = table.columns[index].kind is Rate, [line.title for line in table.lines]
    rich_table = Grid(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    rich_table.add_column(Words(table.heading), width=TITLE_WIDTH, overflow="fold")
    rich_table.add_column("success" if is_rate else "control steps", justify="right", width=20)
    for heading in [CLEAN] * is_rate + ["violations"] * (violations_index is not None):
        rich_table.add_column(heading, justify="right", width=13)
    rich_table.add_column("paper", justify="right", width=len("100.0 %"))
    for line in table.lines:
        violations = None if violations_index is None else line.cells[violations_index]
        name = line.title if titles.count(line.title) == 1 else _distinct_title(line, table.columns)
        cell = line.cells[index]
        assert isinstance(cell, Rate | Length)  # as the column is `compared`
        fields = [_figure_with_details(cell.figure, *cell.details)]
        if isinstance(cell, Rate):
            fields.append(_figure_with_details(*((MISSING, "") if cell.missing else cell.clean_figure)))
        if isinstance(violations, Violations):
            fields.append(_figure_with_details(violations.figure, *violations.details))
        rich_table.add_row(Words(name), *fields, Words(paper_figure(cell)))
    return rich_table


def _figure_with_details(value: str, *details: str) -> Words:
    """A figure with its details below, dimmed."""
    below = "".join(f"\n{detail}" for detail in details if detail)
    return Words.assemble((value, "dim" if value == MISSING else "bold"), (below, "dim"))


def _distinct_title(line: Line, columns: tuple[Column, ...]) -> str:
    """The title of a row with its texts: `Average, agents 2`."""
    texts = [
        f"{column.title.lower()} {cell.value}"
        for column, cell in zip(columns, line.cells, strict=True)
        if isinstance(cell, Text)
    ]
    return ", ".join([line.title, *texts])

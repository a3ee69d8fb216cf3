"""A table as Markdown, CSV, LaTeX and on the terminal.

Success at the end, success without a violation and violations are shown alike. In Markdown and LaTeX a
column of figures is two, ours and the paper's; of violations, which the paper does not count, it is one.
On the terminal each column is a table of its own, narrow enough for 80 characters.
"""

import csv
import io
import re
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table as Grid
from rich.text import Text

from rf_exp.ablation.statistics import Estimate
from rf_exp.ablation.tables import Cell, Column, Line, Table, Unit
from rf_exp.errors import StageError

MISSING = "missing"
CLEAN = "without a violation"  # generation: at the first attempt
LONG_TEXT = 60  # characters; columns of such texts wrap in LaTeX and are folded away in the report
NAME_WIDTH = 18  # characters of a row's title on the terminal, where longer ones wrap
CSV_FIELDS = (
    *("table", "row", "column", "unit", "status", "value", "low", "high", "n"),
    *("success_paper", "paper", "version", "note", "mean_violations", "clean", "clean_low", "clean_high"),
)


def figure(value: float | str | None, unit: Unit, sign: bool = True) -> str:
    """A number in the unit of its column: `97.5 %`, `80.7`; `missing` for None."""
    if value is None:
        return MISSING
    if isinstance(value, str):
        return value
    if unit in ("rate", "violations"):
        return f"{100 * value:.1f}" + (" %" if sign else "")
    return f"{value:.1f}" if value < 1000 else f"{value:.0f}"


def details(cell: Cell, unit: Unit) -> list[str]:
    """What belongs to our figure: interval with sample size, the rate by the paper's own criterion, the mean
    number of violations.
    """
    loose, many = cell.success_paper, cell.mean_violations
    by_paper = "" if loose in (None, cell.value) else f"paper's criterion {figure(loose, unit)}"
    average = "" if many is None else f"mean {many:.2f}"
    return list(filter(None, [_spread(cell, unit), by_paper, average]))


def clean_figure(clean: Estimate) -> tuple[str, str]:
    """The rate without a violation, and its interval."""
    return figure(clean.value, "rate"), _range(clean.interval, "rate")


def _spread(cell: Cell, unit: Unit) -> str:
    """`[93.1, 99.1] n=200`; empty without them. The sample of violations is that of the figure before."""
    parts = []
    if cell.interval:
        parts.append(_range(cell.interval, unit))
    if cell.n and unit != "violations":
        parts.append(f"n={cell.n}")
    return " ".join(parts)


def _range(interval: tuple[float, float], unit: Unit) -> str:
    return f"[{', '.join(figure(end, unit, sign=False) for end in interval)}]"


def _ours(cell: Cell, unit: Unit) -> str:
    """Our figure in full, in Markdown: the value, then what belongs to it."""
    value = figure(cell.value, unit)
    if unit == "text" or not isinstance(cell.value, float):
        return value
    spread, *further = details(cell, unit) or [""]
    if cell.clean:
        rate, interval = clean_figure(cell.clean)
        further = [f"{CLEAN} **{rate}** {interval}", *further]
    return ", ".join(filter(None, [f"**{value}**", spread, *further]))


def notes(table: Table) -> list[str]:
    """The notes of the table, then those of its cells with their place.

    Violations are of the attempts of the figure before them, so its note says it all.
    """
    placed = [
        f"{line.title}, {column.title}: {cell.note}."
        for line in table.lines
        for column, cell in zip(table.columns, line.cells, strict=True)
        if cell.note and column.compared
    ]
    return [*table.notes, *placed]


def grid(table: Table) -> tuple[list[str], list[list[str]]]:
    """Heading and rows as text, with our figures emphasised as in Markdown."""
    heading = [table.heading]
    for column in table.columns:
        heading += [column.title, "paper"] if column.compared else [column.title]
    rows = []
    for line in table.lines:
        row = [line.title]
        for column, cell in zip(table.columns, line.cells, strict=True):
            row.append(_ours(cell, column.unit))
            if column.compared:
                row.append(figure(cell.paper, column.unit) if cell.paper is not None else "")
        rows.append(row)
    return heading, rows


def is_long(table: Table, index: int) -> bool:
    """Whether a column holds texts too long for a narrow place."""
    return any(len(str(line.cells[index].value)) > LONG_TEXT for line in table.lines)


def markdown(table: Table) -> str:
    heading, rows = grid(table)
    lines = [f"## {table.title}", "", table.caption, ""]
    for row in (heading, ["---"] * len(heading), *rows):
        lines.append("| " + " | ".join(text.replace("|", "\\|") for text in row) + " |")
    lines += ["", *(f"- {note}" for note in notes(table))]
    return "\n".join(lines).rstrip() + "\n"


def tidy_csv(table: Table) -> str:
    """One line a cell, numbers as they are: rates in [0, 1], lengths in control steps."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(CSV_FIELDS)
    for line in table.lines:
        for column, cell in zip(table.columns, line.cells, strict=True):
            low, high = cell.interval or (None, None)
            status = MISSING if cell.value is None else "text" if column.unit == "text" else "measured"
            place = (table.name, line.key, column.key, column.unit, status)
            numbers = (cell.value, low, high, cell.n, cell.success_paper, cell.paper)
            clean = (cell.clean.value, *cell.clean.interval) if cell.clean else (None, None, None)
            writer.writerow((*place, *numbers, cell.version, cell.note, cell.mean_violations, *clean))
    return buffer.getvalue()


def latex(table: Table) -> str:
    """A booktabs table."""
    heading, rows = grid(table)
    aligned = "l"
    for index, column in enumerate(table.columns):
        aligned += "p{4cm}" if is_long(table, index) else "ll" if column.compared else "l"
    strong = re.compile(r"\*\*(.+?)\*\*")
    body = [" & ".join(strong.sub(r"\\textbf{\1}", _escape(text)) for text in row) + r" \\" for row in rows]
    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{_escape(table.caption)}}}",
        rf"\label{{tab:{table.name}}}",
        rf"\begin{{tabular}}{{{aligned}}}",
        r"\toprule",
        " & ".join(_escape(text) for text in heading) + r" \\",
        r"\midrule",
        *body,
        r"\bottomrule",
        r"\end{tabular}",
        *(rf"\par\footnotesize {_escape(note)}" for note in notes(table)),
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"


def write(table: Table, folder: Path) -> list[Path]:
    """`<name>.md`, `.csv` and `.tex` in the folder. Raises StageError when they cannot be written."""
    texts = {"md": markdown(table), "csv": tidy_csv(table), "tex": latex(table)}
    paths = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for suffix, text in texts.items():
            path = folder / f"{table.name}.{suffix}"
            path.write_text(text, "utf-8")
            paths.append(path)
    except OSError as error:
        raise StageError(f"cannot write table {table.name} to {folder}: {error.strerror or error}") from error
    return paths


def show(table: Table, console: Console) -> None:
    """On the terminal: for each column of figures a table that fits 80 characters, then the notes.

    Texts stay away, but for those that tell rows of one title apart.
    """
    console.print(Text(f"\n{table.title}", style="bold"))
    for index, after in table.compared:
        title = table.columns[index].title
        if any(line.cells[index].value is not None for line in table.lines):
            console.print(Text(f"\n{title}", style="italic"), _column(table, index, after), sep="\n", end="")
        else:
            console.print(Text.assemble((f"\n{title}", "italic"), f": {MISSING}"))
    for note in notes(table):
        console.print(Text(f"- {note}"), soft_wrap=False)


def _column(table: Table, index: int, after: int | None) -> Grid:
    """One column: our figures, the rates without a violation, the violations, the paper's figures."""
    column, titles = table.columns[index], [line.title for line in table.lines]
    shown = Grid(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    shown.add_column(Text(table.heading), width=NAME_WIDTH)
    shown.add_column("success" if column.unit == "rate" else "control steps", justify="right", width=20)
    for heading in [CLEAN] * (column.unit == "rate") + ["violations"] * (after is not None):
        shown.add_column(heading, justify="right", width=13)
    shown.add_column("paper", justify="right", width=len("100.0 %"))
    for line in table.lines:
        cell = line.cells[index]
        fields = [_stacked(figure(cell.value, column.unit), *details(cell, column.unit))]
        if column.unit == "rate":
            rate = (MISSING, "") if cell.value is None else ("", "")
            fields.append(_stacked(*(clean_figure(cell.clean) if cell.clean else rate)))
        if after is not None:
            beside = line.cells[after]
            fields.append(_stacked(figure(beside.value, "violations"), *details(beside, "violations")))
        fields.append(Text("" if cell.paper is None else figure(cell.paper, column.unit)))
        name = line.title if titles.count(line.title) == 1 else _told_apart(line, table.columns)
        shown.add_row(Text(name), *fields)
    return shown


def _stacked(value: str, *details: str) -> Text:
    """A figure with what belongs to it below, fainter."""
    below = "".join(f"\n{detail}" for detail in details if detail)
    return Text.assemble((value, "dim" if value == MISSING else "bold"), (below, "dim"))


def _told_apart(line: Line, columns: tuple[Column, ...]) -> str:
    """The title of a row with its texts: `Average, agents 2`."""
    texts = [
        f"{column.title.lower()} {cell.value}"
        for column, cell in zip(columns, line.cells, strict=True)
        if column.unit == "text"
    ]
    return ", ".join([line.title, *texts])


def _escape(text: str) -> str:
    special = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
    special |= {character: "\\" + character for character in "&%$#_{}"}
    return "".join(special.get(character, character) for character in text)

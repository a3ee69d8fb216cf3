"""A table as Markdown, CSV, LaTeX and on the terminal.

In Markdown and LaTeX a column of figures is two, ours and the paper's; of violations, which the paper
does not count, it is one.
"""

import csv
import io
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table as Grid

from rf_exp.ablation.tables import Cell, Column, Table, Unit
from rf_exp.errors import StageError

MISSING = "missing"
LONG_TEXT = 60  # characters; columns of such texts wrap in LaTeX and stay off the terminal
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
    """What belongs to our figure: interval with sample size, the rate without a violation, the rate by the
    paper's own criterion, the mean number of violations.
    """
    loose, many = cell.success_paper, cell.mean_violations
    by_paper = "" if loose in (None, cell.value) else f"paper's criterion {figure(loose, unit)}"
    average = "" if many is None else f"mean {many:.2f}"
    unmended = ""
    if clean := cell.unmended:
        unmended = f"without a violation {figure(clean.value, unit)} {_range(clean.interval, unit)}"
    return list(filter(None, [_spread(cell, unit), unmended, by_paper, average]))


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


def ours(cell: Cell, unit: Unit) -> list[str]:
    """Our figure in full: the value, then what belongs to it."""
    return [figure(cell.value, unit), *details(cell, unit)]


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
    """Heading and rows as text."""
    heading = [table.heading]
    for column in table.columns:
        heading += [column.title, "paper"] if column.compared else [column.title]
    rows = []
    for line in table.lines:
        row = [line.title]
        for column, cell in zip(table.columns, line.cells, strict=True):
            row.append(", ".join(ours(cell, column.unit)))
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
    body = [" & ".join(_escape(text) for text in row) + r" \\" for row in rows]
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
    """On the terminal: without its long texts, and with the paper's figures below ours to save columns."""
    caption = escape("\n".join(notes(table))) or None
    shown = Grid(title=escape(table.title), caption=caption, caption_justify="left")
    narrow = _narrow(table)
    shown.add_column(escape(narrow.heading), overflow="fold", min_width=6)
    for column in narrow.columns:
        width = 6 if column.unit == "text" else len(MISSING)
        shown.add_column(escape(column.title), justify="right", overflow="fold", min_width=width)
    for line in narrow.lines:
        shown.add_row(escape(line.title), *map(escape, map(_stacked, line.cells, narrow.columns)))
    console.print(shown)


def _stacked(cell: Cell, column: Column) -> str:
    paper = [] if cell.paper is None else [f"paper {figure(cell.paper, column.unit)}"]
    return "\n".join([*ours(cell, column.unit), *paper])


def _narrow(table: Table) -> Table:
    keep = [index for index in range(len(table.columns)) if not is_long(table, index)]
    lines = (replace(line, cells=tuple(line.cells[i] for i in keep)) for line in table.lines)
    return replace(table, columns=tuple(table.columns[i] for i in keep), lines=tuple(lines))


def _escape(text: str) -> str:
    special = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
    special |= {character: "\\" + character for character in "&%$#_{}"}
    return "".join(special.get(character, character) for character in text)

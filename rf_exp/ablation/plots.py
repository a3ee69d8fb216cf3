"""Plots as SVG text that takes its colours from the page, so that they follow light and dark mode."""

import csv
import io
from collections.abc import Mapping, Sequence
from math import isfinite
from operator import itemgetter
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rf_exp.ablation.tables import Cell, Column, Length, Line, Rate, Table, Text

# Colours that stand for variables of the page's style sheet; replaced in the finished SVG.
INK, FAINT = "#010203", "#040506"
OURS, PAPER = "#070809", "#0a0b0c"
FURTHER = ("#0d0e0f", "#101112", "#131415")
VARIABLES = {
    INK: "var(--ink)",
    FAINT: "var(--line)",
    OURS: "var(--ours)",
    PAPER: "var(--paper)",
    FURTHER[0]: "var(--c3)",
    FURTHER[1]: "var(--c4)",
    FURTHER[2]: "var(--c5)",
}
STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",  # real text, in the page's font
    "font.size": 9,
    "text.color": INK,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.spines.left": False,
    "grid.color": FAINT,
    "xtick.color": INK,
    "ytick.color": INK,
    "ytick.left": False,
    "legend.frameon": False,
}
WIDTH_IN = 4.2


def dots(lines: Sequence[Line], index: int, column: Column, salt: str) -> str:
    """A row of the table a line: ours with its interval, also without violations, and the paper's."""
    with rc_context({**STYLE, "svg.hashsalt": salt}):
        figure = Figure((WIDTH_IN, 0.75 + 0.34 * len(lines)), layout="constrained")
        axes = figure.add_subplot()
        for place, line in enumerate(lines):
            cell = line.cells[index]
            assert isinstance(cell, Rate | Length)  # of a column that the paper has too
            _dot(axes, place, cell)
        titles = [line.title for line in lines]
        unique = len(set(titles)) == len(titles)
        labels = titles if unique else [line.key for line in lines]
        axes.set_yticks(range(len(lines)), [label.replace("_", " ") for label in labels])
        axes.set_ylim(len(lines) - 0.5, -0.5)
        axes.grid(axis="y", visible=False)
        if column.kind is Rate:
            axes.set_xlim(-2, 102)
            axes.set_xlabel("success, %")
        else:
            axes.set_xlim(0, 1.08 * axes.dataLim.xmax)
            axes.set_xlabel("control steps")
        return _svg(figure, axes)


def _dot(axes: Axes, place: int, cell: Rate | Length) -> None:
    """One line of `dots`."""
    scale = 100 if isinstance(cell, Rate) else 1
    if cell.value is not None:
        low, high = cell.interval or (cell.value, cell.value)
        axes.plot([scale * low, scale * high], [place] * 2, color=OURS, lw=2.2)
        axes.plot(scale * cell.value, place, "o", color=OURS, ms=6.5, label="ours, 95 % interval")
    if isinstance(cell, Rate) and (clean := cell.unmended):
        axes.plot([scale * end for end in clean.interval], [place] * 2, color=OURS, lw=1.0)
        mended = {"mfc": "none", "mec": OURS, "mew": 1.6, "ms": 6, "label": "no violation"}
        axes.plot(scale * clean.value, place, "o", **mended)
    if cell.paper is not None:
        axes.plot(scale * cell.paper, place, "D", mfc="none", mec=PAPER, mew=1.6, ms=6, label="paper")


def over_demos(line: Line, columns: Sequence[Column], salt: str) -> str:
    """Success of one task against the number of demonstrations, ours and the paper's."""
    points = [
        (column.demos, cell)
        for column, cell in zip(columns, line.cells, strict=True)
        if column.demos is not None and isinstance(cell, Rate)
    ]
    with rc_context({**STYLE, "svg.hashsalt": salt}):
        figure = Figure((WIDTH_IN, 2.3), layout="constrained")
        axes = figure.add_subplot()
        known = [(demos, 100 * cell.paper) for demos, cell in points if cell.paper is not None]
        if known:
            axes.plot(
                *zip(*known, strict=True), "D--", color=PAPER, mfc="none", mew=1.6, lw=1.2, label="paper"
            )
        for demos, cell in points:
            if cell.interval:
                axes.plot([demos] * 2, [100 * end for end in cell.interval], color=OURS, lw=2.2)
        own = [(demos, 100 * cell.value) for demos, cell in points if cell.value is not None]
        axes.plot(*zip(*own, strict=True), "o-", color=OURS, ms=6.5, label="ours, 95 % interval")
        axes.set_ylim(-2, 102)
        axes.set_xticks([demos for demos, _ in points])
        axes.set_xlabel("demonstrations")
        axes.set_ylabel("success, %")
        return _svg(figure, axes)


def curves(columns: Mapping[str, Sequence[float]], salt: str) -> str:
    """Loss over the first column of a training log; every column named after a loss is a line.

    Columns may have gaps (NaN), such as a validation loss measured now and then.

    Raises ValueError when no column is.
    """
    losses = {n: v for n, v in columns.items() if "loss" in n.lower() and any(map(isfinite, v))}
    if not losses:
        raise ValueError(f"no column named after a loss; columns: {', '.join(columns)}")
    along = next(iter(columns))
    with rc_context({**STYLE, "svg.hashsalt": salt}):
        figure = Figure((WIDTH_IN, 2.3), layout="constrained")
        axes = figure.add_subplot()
        for (name, values), colour in zip(losses.items(), (OURS, PAPER, *FURTHER), strict=False):
            known = [(x, y) for x, y in zip(columns[along], values, strict=True) if isfinite(y)]
            axes.plot(*zip(*known, strict=True), color=colour, lw=1.4, label=name.replace("_", " "))
        if all(value > 0 for values in losses.values() for value in values if isfinite(value)):
            axes.set_yscale("log")
        axes.set_xlabel(along.replace("_", " "))
        axes.set_ylabel("loss")
        return _svg(figure, axes)


def read_curves(path: Path) -> dict[str, list[float]]:
    """Column -> values of a CSV file with a heading; an empty field is NaN, an unfinished row left out.

    Raises ValueError for anything else.
    """
    with path.open(newline="", encoding="utf-8") as file:
        heading, *rows = list(csv.reader(file)) or [[]]
    whole = [row for row in rows if len(row) == len(heading)]
    if not whole:
        raise ValueError("no rows")
    return {name: [float(row[i] or "nan") for row in whole] for i, name in enumerate(heading)}


def measured(cells: Sequence[Cell]) -> bool:
    """Whether there is anything of ours to draw."""
    return any(not isinstance(cell, Text) and cell.value is not None for cell in cells)


def panels(table: Table) -> list[tuple[str, str]]:
    """(title, SVG) for each column of the table that has figures of ours beside the paper's."""
    return [
        (column.title, dots(table.lines, index, column, f"{table.name}-{column.key}"))
        for index, column in enumerate(table.columns)
        if column.compared and measured([line.cells[index] for line in table.lines])
    ]


def _svg(figure: Figure, axes: Axes) -> str:
    handles, labels = axes.get_legend_handles_labels()
    named = dict(sorted(zip(labels, handles, strict=True), key=itemgetter(0)))
    figure.legend(named.values(), named.keys(), loc="outside upper left", ncols=3, fontsize=9)
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None})
    text = buffer.getvalue()
    for colour, variable in VARIABLES.items():
        text = text.replace(colour, variable)
    return text[text.index("<svg") :]

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
from matplotlib.patches import Rectangle

from rf_exp.ablation.tables.robustness import sort_variations
from rf_exp.ablation.tables.table import Cell, Column, Length, Line, Rate, Table, Text

# Placeholder colours for variables of the page's style sheet; replaced in the finished SVG.
COLOUR_VARIABLES = {
    **{"ink": "#010203", "line": "#040506", "ours": "#070809", "paper": "#0a0b0c"},
    **{"c3": "#0d0e0f", "c4": "#101112", "c5": "#131415"},
}
INK, FAINT, OUR_COLOUR, PAPER_COLOUR, *MORE_COLOURS = COLOUR_VARIABLES.values()
STYLE: dict[Any, Any] = {
    **{"svg.fonttype": "none", "font.size": 9, "axes.grid": True},  # real text, in the page's font
    **dict.fromkeys(("text.color", "axes.labelcolor", "xtick.color", "ytick.color"), INK),
    **dict.fromkeys(("axes.edgecolor", "grid.color"), FAINT),
    **dict.fromkeys((f"axes.spines.{side}" for side in ("top", "right", "left")), False),
    **dict.fromkeys(("ytick.left", "legend.frameon"), False),
}
WIDTH_IN = 4.2
MAX_OPACITY = 0.55  # opacity of a map's cell where all succeeded, low enough to read numbers on it
MAX_HORIZONTAL_LABELS = 3  # most tasks whose names fit side by side; names of more are vertical


def dot_plot(lines: Sequence[Line], index: int, column: Column, salt: str) -> str:
    """Dot plot, a line per row of the table: ours with its interval, also without violations; the paper's."""
    with rc_context({**STYLE, "svg.hashsalt": salt}):
        figure = Figure((WIDTH_IN, 0.75 + 0.34 * len(lines)), layout="constrained")
        axes = figure.add_subplot()
        for position, line in enumerate(lines):
            cell = line.cells[index]
            assert isinstance(cell, Rate | Length)  # as the column is `compared`
            scale = 100 if isinstance(cell, Rate) else 1
            if cell.value is not None:
                low, high = cell.interval or (cell.value, cell.value)
                axes.plot([scale * low, scale * high], [position] * 2, color=OUR_COLOUR, lw=2.2)
                axes.plot(
                    scale * cell.value, position, "o", color=OUR_COLOUR, ms=6.5, label="ours, 95 % interval"
                )
            if isinstance(cell, Rate) and (clean := cell.clean_if_different):
                axes.plot([scale * end for end in clean.interval], [position] * 2, color=OUR_COLOUR, lw=1.0)
                style = {"mfc": "none", "mec": OUR_COLOUR, "mew": 1.6, "ms": 6, "label": "no violation"}
                axes.plot(scale * clean.value, position, "o", **style)
            if cell.paper is not None:
                paper_style = {"mfc": "none", "mec": PAPER_COLOUR, "mew": 1.6, "ms": 6, "label": "paper"}
                axes.plot(scale * cell.paper, position, "D", **paper_style)
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
        paper_points = [(demos, 100 * cell.paper) for demos, cell in points if cell.paper is not None]
        if paper_points:
            axes.plot(
                *zip(*paper_points, strict=True),
                "D--",
                color=PAPER_COLOUR,
                mfc="none",
                mew=1.6,
                lw=1.2,
                label="paper",
            )
        for demos, cell in points:
            if cell.interval:
                axes.plot([demos] * 2, [100 * end for end in cell.interval], color=OUR_COLOUR, lw=2.2)
        own_points = [(demos, 100 * cell.value) for demos, cell in points if cell.value is not None]
        axes.plot(*zip(*own_points, strict=True), "o-", color=OUR_COLOUR, ms=6.5, label="ours, 95 % interval")
        axes.set_ylim(-2, 102)
        axes.set_xticks([demos for demos, _ in points])
        axes.set_xlabel("demonstrations")
        axes.set_ylabel("success, %")
        return _svg(figure, axes)


def curves(columns: Mapping[str, Sequence[float]], salt: str) -> str:
    """Losses over the first column of a training log: a line for every column with `loss` in its name.

    Columns may have gaps (NaN), such as a validation loss measured now and then. Raises ValueError without
    such a column.
    """
    losses = {n: v for n, v in columns.items() if "loss" in n.lower() and any(map(isfinite, v))}
    if not losses:
        raise ValueError(f"no column named after a loss; columns: {', '.join(columns)}")
    x_name = next(iter(columns))
    with rc_context({**STYLE, "svg.hashsalt": salt}):
        figure = Figure((WIDTH_IN, 2.3), layout="constrained")
        axes = figure.add_subplot()
        for (name, values), colour in zip(
            losses.items(), (OUR_COLOUR, PAPER_COLOUR, *MORE_COLOURS), strict=False
        ):
            points = [(x, y) for x, y in zip(columns[x_name], values, strict=True) if isfinite(y)]
            axes.plot(*zip(*points, strict=True), color=colour, lw=1.4, label=name.replace("_", " "))
        if all(value > 0 for values in losses.values() for value in values if isfinite(value)):
            axes.set_yscale("log")
        axes.set_xlabel(x_name.replace("_", " "))
        axes.set_ylabel("loss")
        return _svg(figure, axes)


def read_curves(path: Path) -> dict[str, list[float]]:
    """Column -> values of a CSV file with a heading; an empty field is NaN, an unfinished row left out.

    Raises ValueError for anything else.
    """
    with path.open(newline="", encoding="utf-8") as file:
        heading, *rows = list(csv.reader(file)) or [[]]
    complete = [row for row in rows if len(row) == len(heading)]
    if not complete:
        raise ValueError("no rows")
    return {name: [float(row[i] or "nan") for row in complete] for i, name in enumerate(heading)}


def has_values(cells: Sequence[Cell]) -> bool:
    return any(not isinstance(cell, Text) and cell.value is not None for cell in cells)


def panels(table: Table) -> list[tuple[str, str]]:
    """(title, SVG) for each column of the table that has figures of ours beside the paper's."""
    return [
        (column.title, dot_plot(table.lines, index, column, f"{table.name}-{column.key}"))
        for index, column in enumerate(table.columns)
        if column.compared and has_values([line.cells[index] for line in table.lines])
    ]


def success_maps(table: Table) -> list[tuple[str, str]]:
    """(title, SVG) for each policy of the robustness table: strict success by task and by factor."""
    indices = {column.key: index for index, column in enumerate(table.columns)}
    by_policy: dict[str, dict[tuple[str, str], Rate]] = {}
    for line in table.lines:
        recipe, learned_on, demos, scenes, rate = (
            line.cells[indices[key]] for key in ("recipe", "learned_on", "demos", "scenes", "strict")
        )
        assert isinstance(scenes, Text) and isinstance(rate, Rate)
        policy = f"{recipe.value}, learned on {learned_on.value}, {demos.value} demos"
        by_policy.setdefault(policy, {})[line.title, scenes.value] = rate
    tasks = list(dict.fromkeys(line.title for line in table.lines))
    factors = sort_variations(factor for rates in by_policy.values() for _, factor in rates)
    return [
        (policy, success_map(rates, tasks, factors, f"{table.name}-{policy}"))
        for policy, rates in by_policy.items()
    ]


def success_map(
    rates: Mapping[tuple[str, str], Rate], tasks: Sequence[str], factors: Sequence[str], salt: str
) -> str:
    """Heat map of success with a column for each task and a row for each factor; more opaque is better."""
    with rc_context({**STYLE, "svg.hashsalt": salt, "axes.grid": False}):
        names_in = 0.3 if len(tasks) <= MAX_HORIZONTAL_LABELS else 1.5
        figure = Figure((WIDTH_IN, 0.6 + names_in + 0.24 * len(factors)), layout="constrained")
        axes = figure.add_subplot()
        for (task, factor), rate in rates.items():
            if rate.value is None:
                continue
            x, y = tasks.index(task), factors.index(factor)
            axes.add_patch(
                Rectangle((x - 0.5, y - 0.5), 1, 1, fc=OUR_COLOUR, alpha=MAX_OPACITY * rate.value, lw=0)
            )
            axes.text(x, y, _whole_percent(rate.value), ha="center", va="center", fontsize=8)
        axes.hlines([k - 0.5 for k in range(len(factors) + 1)], -0.5, len(tasks) - 0.5, colors=FAINT, lw=0.6)
        axes.vlines([k - 0.5 for k in range(len(tasks) + 1)], -0.5, len(factors) - 0.5, colors=FAINT, lw=0.6)
        axes.set_xticks(range(len(tasks)), tasks, rotation=90 if len(tasks) > MAX_HORIZONTAL_LABELS else 0)
        axes.set_yticks(range(len(factors)), factors)
        axes.tick_params(top=False, bottom=False, labeltop=True, labelbottom=False)
        axes.set_xlim(-0.5, len(tasks) - 0.5)
        axes.set_ylim(len(factors) - 0.5, -0.5)
        axes.spines["bottom"].set_visible(False)
        axes.set_xlabel("strict success, %")
        return _svg(figure, axes)


def _whole_percent(share: float) -> str:
    """A share in whole per cent; with a decimal where rounding alone would give 0 or 100."""
    percent = round(100 * share)
    return f"{100 * share:.1f}" if percent in (0, 100) and percent != 100 * share else str(percent)


def _svg(figure: Figure, axes: Axes) -> str:
    handles, labels = axes.get_legend_handles_labels()
    handle_by_label = dict(sorted(zip(labels, handles, strict=True), key=itemgetter(0)))
    figure.legend(
        handle_by_label.values(), handle_by_label.keys(), loc="outside upper left", ncols=3, fontsize=9
    )
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None})
    text = buffer.getvalue()
    for variable, colour in COLOUR_VARIABLES.items():
        text = text.replace(colour, f"var(--{variable})")
    return text[text.index("<svg") :]

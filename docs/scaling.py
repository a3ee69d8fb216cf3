"""Writes docs/scaling.md and its figure from benchmarks/scaling.tsv: python docs/scaling.py [ROWS.jsonl]

With ROWS.jsonl, the rows of a run of `benchmarks/arms.py`, that file is replaced first.
"""

import argparse
import csv
import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
from figure import FAINT, STYLE  # of this folder
from matplotlib import rc_context
from matplotlib.figure import Figure

from rf_exp.artifacts import render_template
from rf_exp.texts.markdown import table

ROOT, HERE = Path(__file__).parents[1], Path(__file__).parent
ROWS, PAGE, FIGURE = ROOT / "benchmarks" / "scaling.tsv", HERE / "scaling.md", HERE / "images" / "scaling.svg"
MEMBER_PATTERN = re.compile(r"([a-z]+)_(\d+)x(\d+)")
PLANNING_COLUMNS = ("motion_s", "schedule_s", "checks_s")
NUMBER_COLUMNS = ("seed", "steps", "attempts", "contacts", "makespan", "bound", "peak_mb")
FILE_COLUMNS = ("task", "success", *NUMBER_COLUMNS, *PLANNING_COLUMNS, "physics_s", "episode_s")
COLOURS = {"ring": "#2f81f7", "tower": "#d9702e", "chain": "#3fa34d", "lift": "#a371f7"}
TABLE_COLUMNS = (
    "",
    "strict",
    "at the first attempt",
    "contacts",
    "control steps",
    "makespan over the bound",
    "planning, CPU s",
    "simulator's steps, CPU s",
    "episode, CPU s",
    "slowest episode",
    "MB",
)
Row = dict[str, Any]
Cell = tuple[str, int, int]  # family, arms, objects


def import_rows(rows: Path) -> None:
    """Replaces the rows of the page by those of a run."""
    imported = [json.loads(line) for line in rows.read_text("utf-8").splitlines()]
    imported.sort(key=lambda row: (*_parse_cell(row["task"]), row["seed"]))
    with ROWS.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(
            file, FILE_COLUMNS, delimiter="\t", lineterminator="\n", extrasaction="ignore"
        )
        writer.writeheader()
        writer.writerows({**row, "success": int(row["success"])} for row in imported)


def read() -> dict[Cell, list[Row]]:
    """The rows of each cell: family, number of arms, number of objects."""
    cells: dict[Cell, list[Row]] = {}
    with ROWS.open(encoding="utf-8", newline="") as file:
        for fields in csv.DictReader(file, delimiter="\t"):
            row: Row = {key: float(value) for key, value in fields.items() if key != "task"}
            cells.setdefault(_parse_cell(fields["task"]), []).append(row)
    return cells


def planning_s(rows: list[Row]) -> float:
    """Mean CPU time of motion, schedule and checks, s."""
    return float(np.mean([sum(row[key] for key in PLANNING_COLUMNS) for row in rows]))


def exponent(cells: dict[Cell, list[Row]], family: str, things: int) -> str:
    """Exponent of planning time in the number of arms, from two on; least squares of logarithms."""
    points = [
        (arms, planning_s(rows))
        for (name, arms, count), rows in cells.items()
        if (name, count) == (family, things)
    ]
    points = [each for each in points if each[0] > 1]
    return f"{np.polyfit(*np.log(np.array(points)).T, 1)[0]:.2f}" if len(points) > 2 else ""


def line(cell: Cell, rows: list[Row]) -> list[str]:
    """The table line of a cell."""
    count, bound = len(rows), sum(row["bound"] for row in rows)
    first = sum(row["success"] == 1 and row["attempts"] == 1 for row in rows)
    excess = sum(row["makespan"] for row in rows) / bound - 1 if bound else 0.0
    return [
        f"`{cell[0]}_{cell[1]}x{cell[2]}`",
        f"{sum(row['success'] for row in rows):.0f} of {count}",
        f"{first} of {count}",
        f"{sum(row['contacts'] for row in rows):.0f}",
        f"{np.mean([row['steps'] for row in rows]):.0f}",
        f"{100 * excess:.1f} %",
        f"{planning_s(rows):.2f}",
        f"{np.mean([row['physics_s'] for row in rows]):.2f}",
        f"{np.mean([row['episode_s'] for row in rows]):.2f}",
        f"{max(row['episode_s'] for row in rows):.2f}",
        f"{max(row['peak_mb'] for row in rows):.0f}",
    ]


def draw_figure(cells: dict[Cell, list[Row]]) -> str:
    """SVG: CPU time of planning and of the whole episode over the number of arms, for one object."""
    with rc_context({**STYLE, "svg.hashsalt": "scaling"}):
        figure = Figure((8.0, 3.2), layout="constrained")
        left, right = figure.subplots(1, 2, sharex=True, sharey=True)
        for family, colour in COLOURS.items():
            by_arms = {
                arms: rows
                for (name, arms, things), rows in sorted(cells.items())
                if (name, things) == (family, 1)
            }
            episodes = [np.mean([row["episode_s"] for row in rows]) for rows in by_arms.values()]
            style: Any = {"marker": "o", "ms": 4, "lw": 1.6, "color": colour, "label": family}
            left.plot([*by_arms], [planning_s(rows) for rows in by_arms.values()], **style)
            right.plot([*by_arms], episodes, **style)
        pairs = np.arange(2, 9)
        reference: Any = {"ls": ":", "lw": 1.2, "color": "#768390"}
        left.plot(pairs, 0.04 * pairs * (pairs - 1), label="as the number of pairs", **reference)
        for axes, title in ((left, "planning"), (right, "whole episode")):
            axes.set_xscale("log")
            axes.set_yscale("log")
            axes.set_xticks(range(1, 9), [str(count) for count in range(1, 9)])
            axes.set_yticks([0.1, 1, 10], ["0.1", "1", "10"])
            axes.minorticks_off()
            axes.grid(True, color=FAINT, lw=0.6)
            axes.set_title(f"{title}, CPU s", fontsize=9.5, fontweight="bold", loc="left")
            axes.set_xlabel("arms")
        left.legend(frameon=False, fontsize=8)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None}, transparent=True)
    return re.sub(r" +$", "", buffer.getvalue(), flags=re.MULTILINE)


def document(cells: dict[Cell, list[Row]]) -> str:
    """The page."""
    families = [
        (family, things)
        for family in COLOURS
        for things in sorted({cell[2] for cell in cells if cell[0] == family})
    ]
    exponents = [(f"`{family}`", str(things), exponent(cells, family, things)) for family, things in families]
    all_rows = [row for rows in cells.values() for row in rows]
    return render_template(
        HERE / "scaling.jinja",
        cells=table(TABLE_COLUMNS, [line(cell, rows) for cell, rows in sorted(cells.items(), key=_sort_key)]),
        exponents=table(("family", "things", "exponent"), [each for each in exponents if each[2]]),
        seeds=len({row["seed"] for row in all_rows}),
        scenes=f"{len(all_rows):,}",
        succeeded=f"{sum(row['success'] for row in all_rows):,.0f}",
    )


def _sort_key(item: tuple[Cell, list[Row]]) -> tuple[int, int, int]:
    (family, arms, things), _ = item
    return [*COLOURS].index(family), things, arms


def _parse_cell(task: str) -> Cell:
    match = MEMBER_PATTERN.fullmatch(task)
    assert match is not None, task
    return match[1], int(match[2]), int(match[3])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("rows", type=Path, nargs="?", help="of benchmarks/arms.py")
    if (arguments := parser.parse_args()).rows is not None:
        import_rows(arguments.rows)
    FIGURE.write_text(draw_figure(read()), "utf-8")
    PAGE.write_text(document(read()), "utf-8")

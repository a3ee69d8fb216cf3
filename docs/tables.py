"""Writes tables of README.md, docs/ablation.md, docs/brains.md and docs/expert.md from the rows in results/:

    python docs/tables.py

Tables are between `<!-- NAME: docs/tables.py -->` and `<!-- end -->`. Everything else is written by hand.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from policies import CHALLENGE_BEST, measured, paper_table_cells, percent, rate, rows_by_policy

from rf_exp.ablation import (
    BASELINE_ARCH,
    PUBLISHED,
    Estimate,
    GenerationRow,
    Results,
    brains,
    configured,
    core_minutes,
    is_baseline,
    load,
    mean,
    paper,
    read_rows,
    title_of,
    transposed,
    wilson,
)
from rf_exp.texts.markdown import table

ROOT = Path(__file__).parents[1]
SCENE_COLUMNS = {"none": "nominal scenes", "posture": "other initial postures", "full": "all factors"}


def policies() -> str:
    """Strict rates of our recipe at the largest number of demonstrations, beside the paper's."""
    cells, demos = paper_table_cells(rows_by_policy(measured())), paper().demos[-1]
    lines = [
        (
            title_of(task, configured()),
            str(agents),
            f"**{percent(rate(cells[task, BASELINE_ARCH, demos]))}**",
            percent(paper().baseline[task][demos]),
        )
        for task, agents in paper().levels.items()
        if (task, BASELINE_ARCH, demos) in cells
    ]
    return table(("task", "arms", "rf_exp", "paper"), lines)


def challenge() -> str:
    """Strict success in the tasks that the challenge adds, without and with crop refinement."""
    rows = [
        row for row in measured() if is_baseline(row) and not row.shield and row.demos == paper().demos[-1]
    ]
    lines = []
    for task, best in CHALLENGE_BEST.items():
        of_task = [row for row in rows if row.task == task]
        groups = ([row for row in of_task if row.recipe == recipe] for recipe in ("fast", "crop_refinement"))
        shares = (f"**{percent(rate(group))}**" if group else "" for group in groups)
        lines.append((title_of(task, configured()), str(configured()[task].agents), *shares, f"{best} %"))
    return table(("task", "arms", "`fast`", "`crop_refinement`", "best published"), lines)


def robust() -> str:
    """Strict success of `robust` in three kinds of scenes, with the most demonstrations of each task."""
    rows = [row for row in load(ROOT).evaluation if row.recipe == "robust+full"]
    rows, lines = [row for row in rows if is_baseline(row) and not row.shield], []
    for task, configuration in configured().items():
        demos = max((row.demos for row in rows if row.task == task), default=0)
        of_task = [row for row in rows if (row.task, row.demos) == (task, demos)]
        by_scenes = {scenes: [row for row in of_task if row.variation == scenes] for scenes in SCENE_COLUMNS}
        if all(by_scenes.values()):
            shares = (f"**{percent(rate(group))}**" for group in by_scenes.values())
            counts = str(configuration.agents), str(demos)
            minutes = f"{core_minutes(by_scenes['none']):.0f}"
            lines.append((title_of(task, configured()), *counts, *shares, minutes))
    heading = "task", "arms", "demonstrations", *SCENE_COLUMNS.values(), "core-minutes of learning"
    return table(heading, lines)


def experts() -> str:
    """Success rate and length of the expert's demonstrations."""
    lines, tasks = [], {name: task.agents for name, task in configured().items()}
    for task, agents in {**paper().levels, **dict(sorted(tasks.items(), key=lambda each: each[1]))}.items():
        rows = read_rows(ROOT / "results" / "expert" / f"{task}{PUBLISHED}", GenerationRow)
        success_rate = wilson(sum(row.success for row in rows), len(rows))
        lines.append(
            (
                title_of(task, configured()),
                str(agents),
                f"{sum(row.success for row in rows)} of {len(rows)}",
                f"{100 * success_rate.low:.1f} to {100 * success_rate.high:.1f} %",
                str(sum(row.success_paper for row in rows)),
                f"{_lengths(rows).value:.1f}",
            )
        )
    heading = "task", "arms", "strict success", "95 % interval", "paper's criterion", "mean steps at 20 Hz"
    return table(heading, lines)


def ablation_success() -> str:
    """Success at the first attempt and in the end, beside the paper's."""
    heading, lines = ["success, %"], []
    for name in _ablated():
        heading += [f"{name}: first", "end", "paper"]
    for kind, figures in paper().ablation_success.items():
        line = [f"`{kind}`"]
        for task in figures:
            rows = _cell(task, kind)
            line += [_estimate_text(wilson(n, len(rows)), 100) for n in _successes(rows)]
            line.append(f"{100 * figures[task]:.1f}")
        lines.append(line)
    return table(heading, lines)


def ablation_length() -> str:
    """Mean lengths of the successes, beside the paper's."""
    heading, lines = ["control steps of the successes"], []
    for name in _ablated():
        heading += [name, "paper"]
    for kind, figures in paper().ablation_length.items():
        line = [f"`{kind}`"]
        for task in figures:
            line += [_estimate_text(_lengths(_cell(task, kind))), f"{figures[task]:g}"]
        lines.append(line)
    return table(heading, lines)


def ablation_others() -> str:
    """For each other task: successes at the first attempt and in the end, seeds, mean length."""
    kinds, paper_tasks = [*paper().ablation_success], {*next(iter(paper().ablation_success.values()))}
    lines = []
    for task in configured():
        if task in paper_tasks or not (ROOT / "results" / "ablation" / task).exists():
            continue
        line = [title_of(task, configured())]
        for kind in kinds:
            rows = _cell(task, kind)
            first, end = _successes(rows)
            mean_steps = f"{_lengths(rows).value:.0f}" if end else "-"
            line.append(f"**{first}**, **{end}** of {len(rows)}; {mean_steps}")
        lines.append(line)
    return table(["first, end; steps", *(f"`{kind}`" for kind in kinds)], lines)


def compared_brains() -> str:
    """One table per task that compares the brains."""
    paths = sorted((ROOT / "results" / "brains").glob(f"*/*{PUBLISHED}"))
    rows = tuple(row for path in paths for row in read_rows(path, GenerationRow))
    brain_tables = transposed(brains(Results(generation=rows), configured()), lambda cell: cell.markdown())
    return "\n\n".join(f"{title}:\n\n{table(heading, lines)}" for title, heading, lines in brain_tables)


def _ablated() -> Iterator[str]:
    """The titles of the tasks of the paper's ablation."""
    return (title_of(task, configured()) for task in next(iter(paper().ablation_success.values())))


def _cell(task: str, kind: str) -> Sequence[GenerationRow]:
    return read_rows(ROOT / "results" / "ablation" / task / f"{kind}{PUBLISHED}", GenerationRow)


def _successes(rows: Sequence[GenerationRow]) -> tuple[int, int]:
    """Number of successes at the first attempt, and in the end."""
    return sum(row.success and row.attempts == 1 for row in rows), sum(row.success for row in rows)


def _lengths(rows: Sequence[GenerationRow]) -> Estimate:
    return mean([row.steps for row in rows if row.success])


def _estimate_text(estimate: Estimate, scale: float = 1) -> str:
    value, low, high = (scale * each for each in (estimate.value, *estimate.interval))
    return f"**{value:.1f}** [{low:.1f}, {high:.1f}]"


TABLE_WRITERS: Mapping[str, Mapping[str, Callable[[], str]]] = {
    "README.md": {"policies": policies, "challenge": challenge, "robust": robust},
    "docs/ablation.md": {"success": ablation_success, "length": ablation_length, "others": ablation_others},
    "docs/brains.md": {"brains": compared_brains},
    "docs/expert.md": {"experts": experts},
}


def documents() -> dict[Path, str]:
    """Path -> text of each document, with tables from the present rows. Exits for a missing marker."""
    texts = {}
    for name, writers in TABLE_WRITERS.items():
        text = (ROOT / name).read_text("utf-8")
        for table_name, write in writers.items():
            begin = f"<!-- {table_name}: docs/tables.py -->\n"
            pattern = re.compile(f"(?<={re.escape(begin)}).*?(?=<!-- end -->)", re.DOTALL)
            text, count = pattern.subn(lambda _, write=write: write() + "\n", text)
            if count != 1:
                raise SystemExit(
                    f"{name} has {begin.strip()} ... <!-- end --> {count} times; expected it once"
                )
        texts[ROOT / name] = text
    return texts


if __name__ == "__main__":
    for path, text in documents().items():
        path.write_text(text, "utf-8")

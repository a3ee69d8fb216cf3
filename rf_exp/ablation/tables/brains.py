"""The table of brains, which conf/experiment/brains.yaml compares."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from statistics import fmean

from rf_exp.ablation.results import Results
from rf_exp.ablation.rows import GenerationRow, grouped, newest
from rf_exp.ablation.statistics import Estimate, wilson
from rf_exp.ablation.tables.counting import BASELINE_BRAIN, BASELINE_CONSTRAINTS, tasks_of
from rf_exp.ablation.tables.inputs import Suite, paper, title_of
from rf_exp.ablation.tables.table import Cell, Column, Line, Share, Table, Text
from rf_exp.findings import Answer, Ruling

NOT_AVAILABLE = "-"  # where there is nothing to count
REPAIRS = 3  # most that have a figure of their own

COLUMNS = (
    Column("brain", "Brain", Text),
    Column("first", "Valid at first", Share),
    Column("repaired", f"Valid after 1 to {REPAIRS} repairs", Text),
    Column("success", "Success", Share),
    Column("repairs", "Repairs", Text),
    Column("refusals", "Refusals", Text),
    Column("tokens", "Tokens", Text),
    Column("idle", "Idle share", Text),
    Column("balance", "Balance", Text),
    Column("makespan", "Makespan", Text),
    Column("precision", "Checker's precision", Text),
    Column("constraints", "Constraints stated / understood / missing", Text),
)
CAPTION = (
    "RoboBrain's answers, by task and brain. Valid: the first plan passed all checks, at the first answer "
    "and after repairs, which are answers after one that was refused. Success: the strict criterion, in "
    "the end. Repairs of a seed, and rounds: each goes on from where a plan was carried out. Refusals by "
    "their code, of all answers. Tokens of a seed, read and written. Idle share: control steps in which "
    "an arm was not told to move; balance: those of the least busy arm in which it was, over those of the "
    "busiest. Makespan: of the plans that passed, over the proven bound. Checker's precision: plans that "
    "it passed and that were carried out without a violation. Constraints of the first answer of a round; "
    "missing: of those that the scripted plan states for the same scene, whatever their numbers."
)


def brains(results: Results, suite: Suite) -> Table:
    """A line for each task and brain, once there are answers of another brain than the scripted one."""
    rows = [row for row in results.generation if _is_compared(row)]
    lines: list[Line] = []
    if any(row.brain != BASELINE_BRAIN for row in rows):
        groups = grouped(rows, lambda row: (row.task, row.brain))
        order = tasks_of([*paper().levels, *suite], rows)
        for task, brain in sorted(groups, key=lambda key: (order.index(key[0]), *_sort_key(key[1]))):
            group_rows = newest(groups[task, brain])[0]
            lines.append(Line(f"{task}-{brain}", title_of(task, suite), (Text(brain), *_cells(group_rows))))
    return Table("brains", "Brains", CAPTION, "Task", COLUMNS, tuple(lines))


def _is_compared(row: GenerationRow) -> bool:
    """Whether a row has answers, under all constraints, for undisturbed motion."""
    return bool(row.dialogue.answers) and row.constraints == BASELINE_CONSTRAINTS and not row.disturbance_rad


def _sort_key(brain: str) -> tuple[bool, str]:
    return brain != BASELINE_BRAIN, brain


def _cells(rows: Sequence[GenerationRow]) -> Iterator[Cell]:
    dialogues = [row.dialogue for row in rows]
    repairs_needed = [each.valid_after for each in dialogues]
    yield _share(sum(k == 0 for k in repairs_needed), rows)
    valid = (
        sum(k is not None and k <= limit for k in repairs_needed) / len(rows)
        for limit in range(1, REPAIRS + 1)
    )
    yield Text(" / ".join(f"{100 * each:.0f}" for each in valid) + " %")
    yield _share(sum(row.success for row in rows), rows)
    rounds = fmean(len(each.rounds) for each in dialogues)
    yield Text(f"{fmean(each.repairs for each in dialogues):.2f} in {rounds:.1f} rounds")
    codes = sum((each.codes for each in dialogues), Counter[str]())
    answers = [answer for each in dialogues for answer in each.answers]
    listed = ", ".join(f"{code} {count}" for code, count in codes.most_common())
    yield Text(f"{listed}; of {len(answers)}" if codes else f"none of {len(answers)}")
    uses_tokens = any(each.calls for each in dialogues)
    tokens = (
        fmean(each.prompt_tokens for each in dialogues),
        fmean(each.completion_tokens for each in dialogues),
    )
    yield Text("{:.0f} + {:.0f}".format(*tokens) if uses_tokens else NOT_AVAILABLE)
    moved = [row for row in rows if row.steps]
    yield _mean(1 - sum(row.dialogue.busy) / (row.steps * len(row.dialogue.busy)) for row in moved)
    busy_counts = [each.busy for each in dialogues if len(each.busy) > 1 and any(each.busy)]
    yield _mean(min(busy) / max(busy) for busy in busy_counts)
    passed = [each for each in answers if each.passed]
    bound_s = sum(each.bound_s for each in passed)
    yield Text(f"{sum(each.makespan_s for each in passed) / bound_s:.3f}" if bound_s else NOT_AVAILABLE)
    carried_out = sum(each.ruling is Ruling.CARRIED_OUT for each in passed)
    yield Text(f"{carried_out} of {len(passed)}" if passed else NOT_AVAILABLE)
    yield _constraints([answer for each in dialogues for answer in each.first_answers])


def _constraints(firsts: Sequence[Answer]) -> Text:
    """Mean numbers of constraints stated, understood and missing."""
    if not firsts:
        return Text(NOT_AVAILABLE)
    counts = [(each.stated, each.understood, each.missing, each.asked) for each in firsts]
    stated, understood, lacking, asked = map(fmean, zip(*counts, strict=True))
    return Text(f"{stated:.1f} / {understood:.1f} / {lacking:.1f} of {asked:.1f}")


def _share(count: int, rows: Sequence[GenerationRow]) -> Share:
    estimate: Estimate = wilson(count, len(rows))
    return Share(estimate.value, estimate.n, estimate.interval, version=rows[0].version)


def _mean(values: Iterable[float]) -> Text:
    sample = list(values)
    return Text(f"{fmean(sample):.2f}" if sample else NOT_AVAILABLE)

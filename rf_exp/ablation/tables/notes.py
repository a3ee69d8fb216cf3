"""Notes below a table: what it leaves out, what cannot be compared, differences between its rows."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence

from rf_exp.ablation.results import Results
from rf_exp.ablation.rows import EvaluationRow, grouped
from rf_exp.ablation.statistics import Estimate, difference
from rf_exp.ablation.tables.counting import BASELINE_CONSTRAINTS, COORDINATED_ARCH
from rf_exp.ablation.tables.table import Column, Line, Rate, Text

ROLLOUT_VIOLATIONS = (
    "Violations: share of the rollouts in which arms touched each other, and the mean number of control "
    "steps of a rollout in which they did."
)
PROPOSAL_VIOLATIONS = (
    "Violations: share of {of} with a proposal that ended in a violation, and the mean number of such "
    "proposals; each row checks only the constraints it has."
)


def learnt_from(results: Results) -> tuple[str, ...]:
    """Notes on rows beside the paper's figures that were made otherwise."""
    notes = []
    if n := sum(row.disturbance_rad > 0 for row in results.generation):
        notes.append(
            f"{n} seeds of disturbed demonstrations do not measure the expert: they count in a column of "
            "their own, and not in the ablation."
        )
    if recipes := sorted({row.recipe for row in results.evaluation if row.observation == "state"}):
        notes.append(
            f"Policies of recipe {', '.join(recipes)} are given the true poses of all things "
            "(privileged state)."
        )
    disturbed = grouped(results.evaluation, lambda row: row.disturbance_rad)
    notes += [
        f"Recipe {', '.join(sorted({row.recipe for row in rows}))} learns from demonstrations whose "
        f"execution was disturbed, by {strength:g} rad."
        for strength, rows in sorted(disturbed.items())
        if strength
    ]
    return tuple(notes)


def shielded(results: Results) -> tuple[str, ...]:
    """Note on the table with the shielded rollouts."""
    n = sum(row.shield for row in results.evaluation)
    return (f"{n} shielded rollouts are in a table of their own, shield.",) if n else ()


def coordinated(rows: Iterable[EvaluationRow]) -> tuple[str, ...]:
    """Note on rollouts whose policies were given more than cameras show."""
    if not any(row.arch == COORDINATED_ARCH for row in rows):
        return ()
    return (
        f"{COORDINATED_ARCH} is separate_local, told by RoboBrain and RoboChecker which subgoal each "
        "agent is at and when it waits, from a plan made in the true state of the scene.",
    )


def left_out(rows: Iterable[EvaluationRow]) -> tuple[str, ...]:
    """Notes on policies that learnt from weaker data, which stay out of the paper's tables."""
    counts = Counter(row.constraints for row in rows if row.constraints != BASELINE_CONSTRAINTS)
    return tuple(
        f"{n} rollouts of policies that learnt from {name} data are not in this table."
        for name, n in sorted(counts.items())
    )


def difference_notes(label: str, rates: Mapping[str, Estimate | None], reference: str) -> list[str]:
    """Differences to a reference in percentage points, with Newcombe's interval, as one note."""
    base = rates.get(reference)
    if base is None:
        return []
    parts = []
    for key, other in rates.items():
        if key != reference and other:
            gap = difference(other, base)
            low, high = 100 * gap.low, 100 * gap.high
            parts.append(f"{key} {100 * gap.value:+.1f} points [{low:+.1f}, {high:+.1f}]")
    return [f"{label}, against {reference}: {'; '.join(parts)}."] if parts else []


def difference_notes_by_column(
    lines: Sequence[Line], columns: Sequence[Column], reference: str, label: str
) -> Iterator[str]:
    """Yields for each column the gaps of its rates to the line titled `reference`; `label` describes them."""
    for index, column in enumerate(columns):
        cells = {line.title: line.cells[index] for line in lines}
        rates = {title: cell.estimate for title, cell in cells.items() if isinstance(cell, Rate)}
        yield from difference_notes(f"{column.title}, {label}", rates, reference)


def mixed_versions(lines: Sequence[Line], by_column: Sequence[Column] = ()) -> tuple[str, ...]:
    """Notes on tasks whose cells were judged by different criteria, and cannot be compared.

    A task is a row, or with `by_column` a column.
    """
    if by_column:
        compared = [(i, column) for i, column in enumerate(by_column) if column.compared]
        cells = {column.title: [line.cells[i] for line in lines] for i, column in compared}
    else:
        cells = {line.title: list(line.cells) for line in lines}
    notes = []
    for task, group in cells.items():
        versions = sorted({cell.version for cell in group if not isinstance(cell, Text)} - {""})
        if len(versions) > 1:
            notes.append(f"{task}: cells of criteria versions {', '.join(versions)} cannot be compared.")
    return tuple(notes)

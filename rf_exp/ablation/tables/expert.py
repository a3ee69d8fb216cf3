"""Ablation tables: success and episode length of the expert under each row of constraints."""

from collections.abc import Callable, Sequence
from itertools import chain

from rf_exp.ablation.results import Results
from rf_exp.ablation.rows import GenerationRow
from rf_exp.ablation.tables import notes
from rf_exp.ablation.tables.counting import BASELINE_BRAIN, group_attempts, lengths, rates, tasks_of
from rf_exp.ablation.tables.inputs import Grid, Suite, paper, title_of
from rf_exp.ablation.tables.table import Cell, Column, Length, Line, Rate, Table, with_violations


def ablation_success(results: Results, suite: Suite) -> Table:
    """Success rate of data generation, seeds as denominators (paper, ablation)."""
    columns, lines = _measured(results, suite, paper().ablation_success, Rate, rates)
    gap_notes = []
    for index, column in enumerate(columns):
        cells = {line.key: cell for line in lines if isinstance(cell := line.cells[index], Rate)}
        estimates = {key: cell.estimate for key, cell in cells.items()}
        clean = {key: cell.clean for key, cell in cells.items()}
        gap_notes += notes.difference_notes(column.title, estimates, "logical")
        if clean != estimates:
            gap_notes += notes.difference_notes(f"{column.title} without a violation", clean, "logical")
    return Table(
        "ablation_success",
        "Ablation: success of generation",
        "Share of all tried scene seeds that gave a valid demonstration; without a violation: at the first "
        "attempt, nothing refused, stopped or mended. " + notes.PROPOSAL_VIOLATIONS.format(of="the seeds"),
        "Constraints",
        columns,
        lines,
        (*gap_notes, *notes.mixed_versions(lines, by_column=columns)),
    )


def ablation_length(results: Results, suite: Suite) -> Table:
    """Mean length of the valid demonstrations (paper, ablation)."""
    columns, lines = _measured(results, suite, paper().ablation_length, Length, lengths)
    return Table(
        "ablation_length",
        "Ablation: episode length",
        "Mean control steps (20 Hz) of the successful demonstrations; shorter is better. "
        + notes.PROPOSAL_VIOLATIONS.format(of="these demonstrations"),
        "Constraints",
        columns,
        lines,
        notes.mixed_versions(lines, by_column=columns),
    )


def _measured(
    results: Results,
    suite: Suite,
    figures: Grid,
    kind: type[Cell],
    cells_of: Callable[[Sequence[GenerationRow], float | None], tuple[Cell, Cell]],
) -> tuple[tuple[Column, ...], tuple[Line, ...]]:
    """Columns by task, lines by constraints; other brains than the scripted one have lines of their own."""
    names, attempts = tasks_of(figures["full"], results.generation), group_attempts(results)
    measured = {(row.constraints, row.brain) for row in results.generation if not row.disturbance_rad}
    keys = [(constraints, BASELINE_BRAIN) for constraints in figures]
    keys += sorted(measured - set(keys), key=lambda key: (key[1], key[0]))
    lines = []
    for constraints, brain in keys:
        scripted = brain == BASELINE_BRAIN
        paper_values = figures.get(constraints, {}) if scripted else {}
        row_groups = ((name, attempts.get((name, constraints, brain, False), [])) for name in names)
        cells = (cells_of(rows, paper_values.get(name)) for name, rows in row_groups)
        title = constraints.replace("_", " + ") if constraints != "full" else "logical + spatial + temporal"
        key = constraints if scripted else f"{constraints}-{brain}"
        line_title = title if scripted else f"{title} ({brain} brain)"
        lines.append(Line(key, line_title, tuple(chain.from_iterable(cells))))
    columns = chain.from_iterable(with_violations(name, title_of(name, suite), kind) for name in names)
    return tuple(columns), tuple(lines)

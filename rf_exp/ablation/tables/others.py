"""Policies that are somebody else's, in the scenes and by the criteria of ours."""

from rf_exp.ablation.results import Results
from rf_exp.ablation.rows import EvaluationRow
from rf_exp.ablation.suite import Suite
from rf_exp.ablation.tables import notes
from rf_exp.ablation.tables.cells import Text, Violations
from rf_exp.ablation.tables.counting import rates, violations
from rf_exp.ablation.tables.selection import BASELINE_CONSTRAINTS, others, tasks_of
from rf_exp.ablation.tables.table import Column, Line, Table, title_of, with_violations


def foreign(everything: Results, suite: Suite) -> Table:
    """A row for each policy of others and each task, shielded rollouts apart."""
    results = others(everything)
    groups: dict[tuple[str, str, int, bool], list[EvaluationRow]] = {}
    for row in results.evaluation:
        if row.constraints == BASELINE_CONSTRAINTS:
            groups.setdefault((row.task, row.recipe, row.demos, row.shield), []).append(row)
    order = tasks_of(suite, results.evaluation)
    lines = []
    for key in sorted(groups, key=lambda group: (order.index(group[0]), *group[1:])):
        (task, name, demos, shield), rows = key, groups[key]
        told = "true poses" if rows[-1].observation == "state" else "what can be measured"
        cells = (
            *(Text(str(demos)), Text(told), Text("yes" if shield else "no")),
            *(*rates(rows, None), violations(rows, "contacts")),
        )
        line = f"{task}-{name}-{demos}{'-shield' * shield}"
        lines.append(Line(line, f"{title_of(task, suite)}, {name}", cells))
    return Table(
        "foreign",
        "Policies of others",
        "Policies that this suite has not trained, in the scenes and by the criteria of those that it has. "
        f"{notes.ROLLOUT_VIOLATIONS} Contacts alike. Demos: demonstrations of this suite that they learned "
        "from, as the person said who evaluated them.",
        "Task, policy",
        (
            Column("demos", "Demos", Text),
            Column("told", "Told", Text),
            Column("shield", "Shield", Text),
            *with_violations("success", "Success"),
            Column("contacts", "contacts", Violations),
        ),
        tuple(lines),
        notes.left_out(results),
    )

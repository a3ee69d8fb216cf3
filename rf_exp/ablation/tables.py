"""Rows in, tables out: the paper's tables with its figures beside ours. Pure functions.

A cell counts every attempt it has, failed ones too, and only those of the newest version of the
success criteria; what was left out is named in a note. Beside every success rate and episode length stand
the violations of the same attempts.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, product
from statistics import fmean
from typing import Literal

from rf_exp.ablation.paper import paper
from rf_exp.ablation.rows import EvaluationRow, GenerationRow, Results, newest
from rf_exp.ablation.statistics import Estimate, difference, mean, wilson
from rf_exp.ablation.suite import Suite
from rf_exp.errors import choices

Unit = Literal["rate", "steps", "violations", "text"]
BASELINE_ARCH = "separate_local"  # the paper's fourth, used for its benchmark
COORDINATED_ARCH = "separate_coordinated"  # ours
BASELINE_CONSTRAINTS = "full"  # whose demonstrations the paper's policies learn from
BASELINE_BRAIN = "scripted"
ROLLOUT_VIOLATIONS = (
    "Violations: share of the rollouts in which arms touched each other, and the mean number of control "
    "steps of a rollout in which they did."
)
PROPOSAL_VIOLATIONS = (
    "Violations: share of {of} with a proposal that ended in a violation, and the mean number of such "
    "proposals; each row checks only the constraints it has."
)
SHIELDED = "{n} shielded rollouts are in a table of their own, `shield`."
LEVEL = "Plan & Control"  # of every task here: RoboBrain answers with subgoals, policies with joint targets


@dataclass(frozen=True)
class Cell:
    """One figure of ours beside the paper's. `value` None means: nothing was measured yet."""

    value: float | str | None = None  # rate in [0, 1], control steps, share with a violation, or text
    n: int = 0  # attempts behind a rate, successes behind a length
    interval: tuple[float, float] | None = None  # 95 %
    paper: float | None = None  # the paper's figure, in the same unit
    note: str = ""
    success_paper: float | None = None  # rate by the paper's own criterion
    version: str = ""  # of the success criteria
    mean_violations: float | None = None  # of an attempt
    clean: Estimate | None = None  # rate of strict success without a violation on the way

    @property
    def unmended(self) -> Estimate | None:
        """The rate without a violation, where it is another than the rate."""
        return self.clean if self.clean is not None and self.clean.value != self.value else None

    @property
    def estimate(self) -> Estimate | None:
        """The figure with its interval, where there is one."""
        if not isinstance(self.value, float) or self.interval is None:
            return None
        return Estimate(self.value, *self.interval, self.n)


@dataclass(frozen=True)
class Column:
    key: str
    title: str
    unit: Unit = "rate"

    @property
    def compared(self) -> bool:
        """Whether the figures are of a kind that the paper has too."""
        return self.unit in ("rate", "steps")


@dataclass(frozen=True)
class Line:
    """One row of a table: a name and a cell for each column."""

    key: str
    title: str
    cells: tuple[Cell, ...]


@dataclass(frozen=True)
class Table:
    """A table of the paper. `heading` is the title of the column of row titles."""

    name: str
    title: str
    caption: str
    heading: str
    columns: tuple[Column, ...]
    lines: tuple[Line, ...]
    notes: tuple[str, ...] = ()

    def cell(self, line: str, column: str) -> Cell:
        """The cell of a row and a column, by their keys. Raises ArgumentError naming what exists."""
        lines = {item.key: item for item in self.lines}
        columns = {item.key: index for index, item in enumerate(self.columns)}
        if line not in lines:
            raise choices(f"row of table {self.name}", line, lines)
        if column not in columns:
            raise choices(f"column of table {self.name}", column, columns)
        return lines[line].cells[columns[column]]

    @property
    def compared(self) -> list[tuple[int, int | None]]:
        """The columns of figures that the paper has too, each with that of its violations, if it has one."""
        units = [column.unit for column in self.columns]
        return [
            (index, index + 1 if units[index + 1 : index + 2] == ["violations"] else None)
            for index, column in enumerate(self.columns)
            if column.compared
        ]

    @property
    def measured(self) -> bool:
        """Whether any figure of ours is in it."""
        units = [column.unit for column in self.columns]
        return any(
            cell.value is not None
            for line in self.lines
            for unit, cell in zip(units, line.cells, strict=True)
            if unit != "text"
        )


def title_of(task: str, suite: Suite) -> str:
    """The configured title of a task; where it is not in the suite its name in title case."""
    known = suite.get(task)
    return known.title if known else task.replace("_", " ").title()


def with_violations(key: str, title: str, unit: Unit = "rate") -> tuple[Column, Column]:
    """A column of figures and the one beside it, of the violations of the same attempts."""
    return Column(key, title, unit), Column(f"{key}_violations", "violations", "violations")


# Cells


def rate_cell(rows: Iterable[GenerationRow | EvaluationRow], figure: float | None) -> Cell:
    """The rate of strict success over every attempt, also without a violation, with Wilson's intervals."""
    kept, note = newest(rows)
    if not kept:
        return Cell(paper=figure)
    estimate = wilson(sum(row.success for row in kept), len(kept))
    seeds = {row.train_seed for row in kept if isinstance(row, EvaluationRow)}
    pooled = f"{len(seeds)} training seeds together" if len(seeds) > 1 else ""
    return Cell(
        value=estimate.value,
        n=len(kept),
        interval=estimate.interval,
        paper=figure,
        note="; ".join(filter(None, [note, pooled])),
        success_paper=sum(row.success_paper for row in kept) / len(kept),
        version=kept[0].version,
        clean=wilson(sum(row.success and not row.violations for row in kept), len(kept)),
    )


def length_cell(rows: Iterable[GenerationRow], figure: float | None) -> Cell:
    """Mean control steps of the successful episodes, with Student's t interval."""
    kept, note = newest(rows)
    if not kept:
        return Cell(paper=figure)
    steps = [float(row.steps) for row in kept if row.success]
    if not steps:
        none = f"no success in {len(kept)} attempts"
        return Cell(
            "no success", 0, None, figure, "; ".join(filter(None, [none, note])), None, kept[0].version
        )
    estimate = mean(steps)
    interval = estimate.interval if len(steps) > 1 else None
    return Cell(estimate.value, len(steps), interval, figure, note, None, kept[0].version)


def violations_cell(rows: Iterable[GenerationRow | EvaluationRow], of: str = "violations") -> Cell:
    """The share of attempts with at least one violation, with Wilson's interval, and the mean number.

    `of` names another field that is counted alike.
    """
    kept, note = newest(rows)
    if not kept:
        return Cell()
    counts = [getattr(row, of) for row in kept]
    estimate = wilson(sum(count > 0 for count in counts), len(kept))
    return Cell(
        value=estimate.value,
        n=len(kept),
        interval=estimate.interval,
        note=note,
        version=kept[0].version,
        mean_violations=fmean(counts),
    )


def rate_cells(rows: Sequence[GenerationRow | EvaluationRow], figure: float | None) -> tuple[Cell, Cell]:
    """The rate of success, and the violations of the same attempts."""
    return rate_cell(rows, figure), violations_cell(rows)


def length_cells(rows: Sequence[GenerationRow], figure: float | None) -> tuple[Cell, Cell]:
    """The length of the successful episodes, and the violations on the way to them."""
    length = length_cell(rows, figure)
    if isinstance(length.value, str):
        return length, Cell(length.value, version=length.version)
    return length, violations_cell([row for row in newest(rows)[0] if row.success])


def text_cell(value: object) -> Cell:
    return Cell(str(value))


# Tables


def tasks(results: Results, suite: Suite) -> Table:
    """Every task: what it asks (paper, supplementary task table) and how far it is solved."""
    results, shielded = _unshielded(results)
    demos, recipe = _demos(results), _recipes(results.evaluation)[0]
    disturbed = any(row.disturbance_rad for row in results.generation)
    columns = [
        Column("agents", "Agents", "text"),
        Column("criteria", "Criteria version", "text"),
        *with_violations("generated", "Data generation"),
        Column("length", "Episode length", "steps"),
        *(with_violations("disturbed", "Data generation, disturbed") if disturbed else ()),
        *_demos_columns(demos),
        Column("description", "Description", "text"),
        Column("condition", "Target condition", "text"),
    ]
    lines = []
    for task in _tasks([*paper().levels, *suite], (*results.generation, *results.evaluation)):
        known = suite.get(task)
        made = _generated(results, task, BASELINE_CONSTRAINTS, BASELINE_BRAIN)
        cells = [
            text_cell(_agents(task, suite) or ""),
            text_cell(known.version if known else ""),
            *rate_cells(made, paper().ablation_success["full"].get(task)),
            length_cell(made, paper().ablation_length["full"].get(task)),
            *(
                rate_cells(_generated(results, task, BASELINE_CONSTRAINTS, BASELINE_BRAIN, True), None)
                if disturbed
                else ()
            ),
            *_baseline_cells(results, task, demos, recipe),
            text_cell(known.description if known else ""),
            text_cell(known.condition if known else ""),
        ]
        lines.append(Line(task, title_of(task, suite), tuple(cells)))
    caption = (
        f"All tasks: demonstrations made under all constraints by the {BASELINE_BRAIN} brain, and "
        f"{BASELINE_ARCH} policies that learnt from them (recipe {recipe}). {ROLLOUT_VIOLATIONS} For data "
        "generation, share of "
        "the seeds with a proposal that ended in a violation, and the mean number of such proposals."
    )
    absent = [title_of(task, suite) for task in paper().levels if task not in suite]
    gap = [f"Tasks of the paper without a configuration: {', '.join(absent)}."] if absent else []
    notes = (*gap, *_left_out(results), *shielded, *_mixed_versions(lines))
    return Table("tasks", "Tasks", caption, "Task", tuple(columns), tuple(lines), notes)


def benchmark(results: Results, suite: Suite) -> Table:
    """Success of the diffusion policy by number of agents and demonstrations (paper, DP baseline).

    The averages are over the paper's tasks of a level, so that they stand beside the paper's.
    """
    results, shielded = _unshielded(results)
    demos = _demos(results)
    recipes = _recipes(results.evaluation)
    columns = (
        Column("agents", "Agents", "text"),
        Column("recipe", "Recipe", "text"),
        *_demos_columns(demos),
        Column("core_minutes", "Core-minutes", "text"),
    )

    def lines_of(names: Iterable[str], recipe: str) -> list[Line]:
        return [
            Line(
                name + _but_first(recipe, recipes),
                title_of(name, suite),
                (
                    text_cell(_agents(name, suite) or ""),
                    text_cell(recipe),
                    *_baseline_cells(results, name, demos, recipe),
                    text_cell(_core_minutes(results, name, recipe)),
                ),
            )
            for name in names
        ]

    lines = []
    for (agents, figures), recipe in product(paper().averages.items(), recipes):
        of_level = lines_of((name for name, level in paper().levels.items() if level == agents), recipe)
        known = {f"demos_{count}": rate for count, rate in figures.items()}
        averages = (
            _average([line.cells[index] for line in of_level], known.get(column.key))
            for index, column in enumerate(columns)
            if column.unit != "text"
        )
        key = f"average_{agents}{_but_first(recipe, recipes)}"
        texts = text_cell(agents), text_cell(recipe)
        lines += [*of_level, Line(key, "Average", (*texts, *averages, text_cell("")))]
    listed = _tasks([*paper().levels, *suite], results.evaluation)
    for recipe in recipes:
        lines += lines_of((name for name in listed if name not in paper().levels), recipe)
    return Table(
        "benchmark",
        "Diffusion policy baseline",
        f"Success rate of {BASELINE_ARCH} policies by number of demonstrations. {ROLLOUT_VIOLATIONS} "
        "Core-minutes: CPU time of learning, of all policies of the task together, at each of these numbers.",
        "Task",
        columns,
        tuple(lines),
        _left_out(results) + shielded + _mixed_versions(lines),
    )


def comparison(results: Results, suite: Suite) -> Table:
    """What embodied benchmarks cover (paper, comparison of benchmarks), and this suite by its tasks."""
    columns = (
        Column("single", "Single-agent", "text"),
        Column("multi", "Multi-agent", "text"),
        Column("level", "Task level", "text"),
    )
    counts = [task.agents for task in suite.values()]
    here = (1 in counts, any(agents > 1 for agents in counts), LEVEL)
    lines = []
    for name, (single, multi, level) in {**paper().comparison, "This suite": here}.items():
        texts = ("yes" if single else "no", "yes" if multi else "no", level)
        lines.append(Line(name, name, tuple(map(text_cell, texts))))
    levels = ", ".join(f"{n} with {agents}" for agents, n in sorted(Counter(counts).items()))
    caption = (
        f"Embodied benchmarks. This suite has {len(suite)} tasks, by number of agents: {levels or 'none'}."
    )
    return Table("comparison", "Comparison of benchmarks", caption, "Benchmark", columns, tuple(lines))


def architectures(results: Results, suite: Suite) -> Table:
    """The four architectures (paper, section 4.2), a row for each number of demonstrations at hand."""
    results, shielded = _unshielded(results)
    rows = [row for row in results.evaluation if row.constraints == BASELINE_CONSTRAINTS]
    names = _tasks(paper().architectures[BASELINE_ARCH], rows)
    known = list(paper().architectures)
    further = sorted({row.arch for row in rows} - set(known))
    recipes = _recipes(rows)
    counts = sorted({(recipes.index(row.recipe), row.demos) for row in rows}) or [(0, paper().demos[-1])]
    columns = (
        Column("demos", "Demos", "text"),
        Column("recipe", "Recipe", "text"),
        *chain.from_iterable(with_violations(name, title_of(name, suite)) for name in names),
    )
    lines, gaps = [], []
    for order, count in counts:
        recipe = recipes[order]
        end = f"-{count}{_but_first(recipe, recipes)}"
        for arch in known + further:
            cells = chain.from_iterable(
                rate_cells(
                    [r for r in rows if (r.arch, r.task, r.demos, r.recipe) == (arch, name, count, recipe)],
                    paper().architectures.get(arch, {}).get(name),
                )
                for name in names
            )
            lines.append(Line(f"{arch}{end}", arch, (text_cell(count), text_cell(recipe), *cells)))
        for index, column in enumerate(columns):
            if column.unit == "rate":
                same = {line.title: line.cells[index].estimate for line in lines if line.key.endswith(end)}
                gaps += _gaps(f"{column.title}, {count} demos, {recipe}", same, BASELINE_ARCH)
    notes = [f"The paper's figures are with {paper().demos[-1]} demonstrations.", *gaps]
    return Table(
        "architectures",
        "Architectures",
        "Success rate of the four architectures: shared or separate policy, global or local view. "
        + ROLLOUT_VIOLATIONS,
        "Architecture",
        columns,
        tuple(lines),
        (
            *notes,
            *_coordinated(rows),
            *_left_out(results),
            *shielded,
            *_mixed_versions(lines, by_column=columns),
        ),
    )


def shield(results: Results, suite: Suite) -> Table:
    """The same policies in the same scenes without and with a shield; a row for each that has both, or one.

    Only scenes that were rolled out both ways are compared, where there are such scenes.
    """
    cells: dict[tuple[str, str, int, str], list[EvaluationRow]] = {}
    for row in results.evaluation:
        if row.constraints == BASELINE_CONSTRAINTS:
            cells.setdefault((row.task, row.arch, row.demos, row.recipe), []).append(row)
    order = _tasks([*paper().levels, *suite], results.evaluation)
    columns = (
        Column("demos", "Demos", "text"),
        Column("recipe", "Recipe", "text"),
        *(
            column
            for key in ("without", "with")
            for column in (
                *with_violations(key, f"{key.title()} shield"),
                Column(f"{key}_contacts", "contacts", "violations"),
            )
        ),
        Column("interventions", "interventions", "violations"),
    )
    lines, gaps = [], []
    for task, arch, demos, recipe in sorted(cells, key=lambda cell: (order.index(cell[0]), *cell[1:])):
        ways = _both_ways(cells[task, arch, demos, recipe])
        if not ways[True]:
            continue
        shown = [text_cell(demos), text_cell(recipe)]
        for way in (False, True):
            shown += [*rate_cells(ways[way], None), violations_cell(ways[way], "contacts")]
        shown.append(violations_cell(ways[True], "interventions"))
        title = f"{title_of(task, suite)}, {arch}"
        lines.append(Line(f"{task}-{arch}-{demos}-{recipe}", title, tuple(shown)))
        rates = {"with": shown[5].estimate, "without": shown[2].estimate}
        gaps += _gaps(f"{title}, {demos} demos, {recipe}", rates, "without")
    return Table(
        "shield",
        "Shielded rollouts",
        "The same policies in the same scenes, as they are and with RoboChecker between them and the arms: "
        "predicted chunks are checked before they are executed, and an arm that would come too close to "
        f"another one waits. {ROLLOUT_VIOLATIONS} Contacts and interventions alike: share of the rollouts, "
        "and mean number of control steps with a contact between arms, or with an arm that the shield kept "
        "from its command.",
        "Task, architecture",
        columns,
        tuple(lines),
        (*gaps, *_coordinated(results.evaluation), *_left_out(results)),
    )


def ablation_success(results: Results, suite: Suite) -> Table:
    """Success rate of data generation, seeds as denominators (paper, ablation)."""
    columns, lines = _ablation(results, suite, "rate", paper().ablation_success, rate_cells)
    gaps = []
    for index, column in enumerate(columns):
        if column.unit == "rate":
            cells = {line.key: line.cells[index] for line in lines}
            rates = {key: cell.estimate for key, cell in cells.items()}
            clean = {key: cell.clean for key, cell in cells.items()}
            gaps += _gaps(column.title, rates, "logical")
            if clean != rates:
                gaps += _gaps(f"{column.title} without a violation", clean, "logical")
    return Table(
        "ablation_success",
        "Ablation: success of generation",
        "Share of all tried scene seeds that gave a valid demonstration; without a violation: at the first "
        "attempt, nothing refused, stopped or mended. " + PROPOSAL_VIOLATIONS.format(of="the seeds"),
        "Constraints",
        columns,
        lines,
        (*gaps, *_mixed_versions(lines, by_column=columns)),
    )


def ablation_length(results: Results, suite: Suite) -> Table:
    """Mean length of the valid demonstrations (paper, ablation)."""
    columns, lines = _ablation(results, suite, "steps", paper().ablation_length, length_cells)
    return Table(
        "ablation_length",
        "Ablation: episode length",
        "Mean control steps (20 Hz) of the successful demonstrations; shorter is better. "
        + PROPOSAL_VIOLATIONS.format(of="these demonstrations"),
        "Constraints",
        columns,
        lines,
        _mixed_versions(lines, by_column=columns),
    )


TABLES: Mapping[str, Callable[[Results, Suite], Table]] = {
    builder.__name__: builder
    for builder in (tasks, comparison, benchmark, architectures, shield, ablation_success, ablation_length)
}


def build(results: Results, suite: Suite) -> dict[str, Table]:
    """Every table, by name, for a suite of tasks."""
    tables = {name: builder(results, suite) for name, builder in TABLES.items()}
    notes = _learnt_from(results)
    return {name: replace(table, notes=(*table.notes, *notes)) for name, table in tables.items()}


def _learnt_from(results: Results) -> tuple[str, ...]:
    """What has to be said of rows that stand beside the paper's figures and were made otherwise."""
    notes = []
    if n := sum(row.disturbance_rad > 0 for row in results.generation):
        notes.append(
            f"{n} seeds of disturbed demonstrations do not measure the expert: they count in a column of "
            "their own, and not in the ablation."
        )
    if told := sorted({row.recipe for row in results.evaluation if row.observation == "state"}):
        notes.append(
            f"Policies of recipe {', '.join(told)} are told the true poses of all things: an oracle."
        )
    by_strength: dict[float, set[str]] = {}
    for row in results.evaluation:
        if row.disturbance_rad:
            by_strength.setdefault(row.disturbance_rad, set()).add(row.recipe)
    notes += [
        f"Recipe {', '.join(sorted(who))} learns from demonstrations whose execution was disturbed, by "
        f"{strength:g} rad."
        for strength, who in sorted(by_strength.items())
    ]
    return tuple(notes)


# What several tables need


def _tasks(known: Iterable[str], rows: Iterable[GenerationRow | EvaluationRow]) -> list[str]:
    """The known tasks in their order, then any further one that has rows."""
    listed = list(dict.fromkeys(known))
    return listed + sorted({row.task for row in rows} - set(listed))


def _unshielded(results: Results) -> tuple[Results, tuple[str, ...]]:
    """The results without shielded rollouts, and a note that says where those are."""
    kept = tuple(row for row in results.evaluation if not row.shield)
    n = len(results.evaluation) - len(kept)
    return replace(results, evaluation=kept), (SHIELDED.format(n=n),) if n else ()


def _both_ways(rows: Sequence[EvaluationRow]) -> dict[bool, list[EvaluationRow]]:
    """Rows without and with a shield: of the scenes that have both, or all where none has."""
    kept = newest(rows)[0]
    scenes = [{(r.train_seed, r.scene_seed) for r in kept if r.shield is way} for way in (False, True)]
    both = scenes[0] & scenes[1]
    return {
        way: [r for r in kept if r.shield is way and (not both or (r.train_seed, r.scene_seed) in both)]
        for way in (False, True)
    }


def _agents(task: str, suite: Suite) -> int | None:
    known = suite.get(task)
    return known.agents if known else paper().levels.get(task)


def _demos(results: Results) -> list[int]:
    """The paper's numbers of demonstrations and any further one that has rows."""
    used = {row.demos for row in results.evaluation if _is_baseline(row)}
    return sorted({*paper().demos, *used})


def _recipes(rows: Iterable[EvaluationRow]) -> list[str]:
    """The recipes that have rows: first the one with the most, last those that are told the state."""
    oracles = {row.recipe: row.observation == "state" for row in rows}
    counts = Counter(row.recipe for row in rows)
    return sorted(counts, key=lambda name: (oracles[name], -counts[name], name)) or ["paper"]


def _but_first(recipe: str, recipes: Sequence[str]) -> str:
    """What tells the lines of further recipes from those of the first."""
    return "" if recipe == recipes[0] else f"-{recipe}"


def core_minutes(rows: Iterable[EvaluationRow]) -> float:
    """CPU time of learning behind the rollouts of one architecture, the mean of its training seeds."""
    return fmean({row.train_seed: row.core_s for row in rows}.values()) / 60


def _core_minutes(results: Results, task: str, recipe: str) -> str:
    """At each number of demonstrations."""
    by_demos: dict[int, list[EvaluationRow]] = {}
    for row in results.evaluation:
        if _is_baseline(row) and (row.task, row.recipe) == (task, recipe) and row.core_s:
            by_demos.setdefault(row.demos, []).append(row)
    return " / ".join(f"{core_minutes(rows):.1f}" for _, rows in sorted(by_demos.items()))


def _coordinated(rows: Iterable[EvaluationRow]) -> Iterator[str]:
    """What has to be said where rollouts were told more than cameras show."""
    if any(row.arch == COORDINATED_ARCH for row in rows):
        yield (
            f"{COORDINATED_ARCH} is separate_local, told by RoboBrain and RoboChecker which subgoal each "
            "agent is at and when it waits, from a plan made in the true state of the scene."
        )


def _is_baseline(row: EvaluationRow) -> bool:
    return (row.arch, row.constraints) == (BASELINE_ARCH, BASELINE_CONSTRAINTS)


def _demos_columns(demos: Iterable[int]) -> Iterator[Column]:
    for count in demos:
        yield from with_violations(f"demos_{count}", f"{count} demos")


def _baseline_cells(results: Results, task: str, demos: Iterable[int], recipe: str) -> Iterator[Cell]:
    ours = [r for r in results.evaluation if _is_baseline(r) and (r.task, r.recipe) == (task, recipe)]
    for count in demos:
        rows = [r for r in ours if r.demos == count]
        yield from rate_cells(rows, paper().baseline.get(task, {}).get(count))


def _generated(
    results: Results, task: str, constraints: str, brain: str, disturbed: bool = False
) -> list[GenerationRow]:
    wanted = (task, constraints, brain, disturbed)
    return [
        row
        for row in results.generation
        if (row.task, row.constraints, row.brain, row.disturbance_rad > 0) == wanted
    ]


def _average(cells: Sequence[Cell], figure: float | None) -> Cell:
    """The mean of the figures of a level; missing until every task of it was measured."""
    values = [cell.value for cell in cells if isinstance(cell.value, float)]
    if len(values) < len(cells):
        note = f"{len(values)} of {len(cells)} tasks measured" if values else ""
        return Cell(paper=figure, note=note)
    means = [cell.mean_violations for cell in cells if cell.mean_violations is not None]
    mean_violations = fmean(means) if means else None
    return Cell(fmean(values), sum(cell.n for cell in cells), None, figure, mean_violations=mean_violations)


def _ablation(
    results: Results,
    suite: Suite,
    unit: Unit,
    figures: Mapping[str, Mapping[str, float]],
    cells_of: Callable[[Sequence[GenerationRow], float | None], tuple[Cell, Cell]],
) -> tuple[tuple[Column, ...], tuple[Line, ...]]:
    """(constraints, task) over generation rows; other brains than the scripted one in rows of their own."""
    names = _tasks(figures["full"], results.generation)
    used = {(row.constraints, row.brain) for row in results.generation if not row.disturbance_rad}
    keys = [(constraints, BASELINE_BRAIN) for constraints in figures]
    keys += sorted(used - set(keys), key=lambda key: (key[1], key[0]))
    lines = []
    for constraints, brain in keys:
        own = brain == BASELINE_BRAIN
        cells = chain.from_iterable(
            cells_of(
                _generated(results, name, constraints, brain),
                figures.get(constraints, {}).get(name) if own else None,
            )
            for name in names
        )
        title = constraints.replace("_", " + ") if constraints != "full" else "logical + spatial + temporal"
        key = constraints if own else f"{constraints}-{brain}"
        lines.append(Line(key, title if own else f"{title} ({brain} brain)", tuple(cells)))
    columns = chain.from_iterable(with_violations(name, title_of(name, suite), unit) for name in names)
    return tuple(columns), tuple(lines)


def _gaps(label: str, rates: Mapping[str, Estimate | None], reference: str) -> list[str]:
    """Differences to a reference in percentage points, with Newcombe's interval, as one note."""
    base = rates[reference]
    if base is None:
        return []
    parts = []
    for key, other in rates.items():
        if key != reference and other:
            gap = difference(other, base)
            low, high = 100 * gap.low, 100 * gap.high
            parts.append(f"{key} {100 * gap.value:+.1f} points [{low:+.1f}, {high:+.1f}]")
    return [f"{label}, against {reference}: {'; '.join(parts)}."] if parts else []


def _left_out(results: Results) -> tuple[str, ...]:
    """Policies that learnt from weaker data stay out of the paper's tables, but not unsaid."""
    counts = Counter(r.constraints for r in results.evaluation if r.constraints != BASELINE_CONSTRAINTS)
    return tuple(
        f"{n} rollouts of policies that learnt from `{name}` data are not in this table."
        for name, n in sorted(counts.items())
    )


def _mixed_versions(lines: Sequence[Line], by_column: Sequence[Column] = ()) -> tuple[str, ...]:
    """Cells of one task that were judged by different criteria cannot be compared: say so.

    A task is a row, or with `by_column` a column.
    """
    if by_column:
        compared = [(i, column) for i, column in enumerate(by_column) if column.compared]
        cells = {column.title: [line.cells[i] for line in lines] for i, column in compared}
    else:
        cells = {line.title: list(line.cells) for line in lines}
    notes = []
    for task, group in cells.items():
        versions = sorted({cell.version for cell in group} - {""})
        if len(versions) > 1:
            notes.append(f"{task}: cells of criteria versions {', '.join(versions)} cannot be compared.")
    return tuple(notes)

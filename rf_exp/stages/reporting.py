"""Tables, report, and where to look: pure functions of the rows that are there."""

from collections.abc import Iterator, Sequence

from rf_exp.ablation import (
    FILM,
    EvaluationRow,
    configured,
    facts,
    paper,
    publish,
    rollout_file,
    show,
    wilson,
)
from rf_exp.experiment import Experiment
from rf_exp.progress import console
from rf_exp.stages.cell import Cell, cells, known_rows, owned

SHOWN = (
    "architectures",
    "recipes",
    "shield",
    "robustness",
    "final",
    "ablation_success",
    "ablation_length",
    "brains",
)


def write_tables(experiment: Experiment) -> None:
    """Writes tables and report, prints the tables that have figures, what was reached, and where to look."""
    with owned(experiment.out / "report.html"):
        tables, report = publish(experiment.out, {**configured(), **facts(experiment.tasks)})
    said = set[str]()  # by one table, so that the next one need not say it again
    for name in SHOWN:
        if name in tables and tables[name].measured:
            show(tables[name], console, said)
    console.print("")
    for line in reached(experiment):
        console.print(line)
    if recordings := sorted((experiment.out / "recordings").rglob("*.rrd")):
        console.print(f"recordings: {len(recordings)}, look at one: rerun {recordings[-1]}")
    console.print(f"report: {report}")
    console.print(f"next: {following(experiment)}")


def reached(experiment: Experiment) -> Iterator[str]:
    """How often the policies of the experiment succeeded, and a film of a success, or else of a failure."""
    for cell in cells(experiment):
        for learned in map(cell.with_arch, experiment.archs):
            if rows := _evaluated(learned):
                found = wilson(sum(row.success for row in rows), len(rows))
                low, high = 100 * found.low, 100 * found.high
                told = f"{sum(row.success for row in rows)} of {len(rows)} scenes succeeded"
                yield f"{learned.place}: {told} (95 % interval {low:.0f} to {high:.0f} %)"
                films = (experiment.out / rollout_file(row, FILM) for row in sorted(rows, key=_worse))
                if film := next(filter(lambda path: path.exists(), films), None):
                    yield f"film: {film}"


def following(experiment: Experiment) -> str:
    """A command to go on with: the paper's next task, or after several tasks all of them."""
    tasks, (last, *others) = [*paper().levels], [task.name for task in experiment.tasks]
    if others:
        return "python -m rf_exp.run -m experiment=benchmark"
    after = tasks.index(last) + 1 if last in tasks else 0
    return f"python -m rf_exp.run task={tasks[after % len(tasks)]}"


def _evaluated(cell: Cell) -> Sequence[EvaluationRow]:
    """The rows of the cell's policies in the scenes of the experiment."""
    scenes, of = cell.experiment.evaluation_seeds, (cell.experiment.train_seed, cell.task.version)
    rows = known_rows(cell.evaluation_path, EvaluationRow)
    return [row for row in rows if row.scene_seed in scenes and (row.train_seed, row.version) == of]


def _worse(row: EvaluationRow) -> tuple[bool, int]:
    return not row.success, row.scene_seed

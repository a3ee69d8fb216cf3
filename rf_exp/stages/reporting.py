"""Reporting: tables, report and summary, as pure functions of the existing rows."""

from collections.abc import Iterator
from pathlib import Path

from rf_exp import ablation
from rf_exp.experiment import Experiment
from rf_exp.progress import console
from rf_exp.stages.cell import artifact_lock, cells, evaluation_rows

PRINTED_TABLES = (  # tables, in this order
    *("architectures", "recipes", "shield", "robustness", "final"),
    *("ablation_success", "ablation_length", "brains"),
)


def write_tables(experiment: Experiment) -> None:
    """Writes tables and report; prints the tables that have figures, success rates, and where files are."""
    with artifact_lock(experiment.out / "report.html"):
        suite = {**ablation.configured(), **ablation.facts(experiment.tasks)}
        tables, report = ablation.publish(experiment.out, suite)
    printed_notes = set[str]()  # notes already printed, which further tables omit
    for name in PRINTED_TABLES:
        if name in tables and tables[name].measured:
            ablation.show(tables[name], console, printed_notes)
    console.print("")
    for line in success_lines(experiment):
        console.print(line)
    if recordings := sorted((experiment.out / "recordings").rglob("*.rrd")):
        console.print(f"recordings: {len(recordings)}, look at one: rerun {recordings[-1]}")
    console.print(f"report: {report}")
    console.print(f"next: {next_command(experiment)}")


def success_lines(experiment: Experiment) -> Iterator[str]:
    """Yields the success rates of the policies, each with a film of a success, or else of a failure."""
    for cell in cells(experiment):
        for policy_cell in map(cell.with_arch, experiment.archs):
            if rows := sorted(
                evaluation_rows(policy_cell), key=lambda row: (not row.success, row.scene_seed)
            ):
                successes = sum(row.success for row in rows)
                estimate = ablation.wilson(successes, len(rows))
                interval = f"95 % interval {100 * estimate.low:.0f} to {100 * estimate.high:.0f} %"
                yield f"{policy_cell.label}: {successes} of {len(rows)} scenes succeeded ({interval})"
                films = (experiment.out / ablation.rollout_file(row, ablation.FILM) for row in rows)
                if film := next(filter(Path.exists, films), None):
                    yield f"film: {film}"


def next_command(experiment: Experiment) -> str:
    """A command to run next: the paper's next task, or after several tasks all of them."""
    tasks, (last, *others) = [*ablation.paper().levels], [task.name for task in experiment.tasks]
    if others:
        return "python -m rf_exp.run -m experiment=benchmark"
    next_index = tasks.index(last) + 1 if last in tasks else 0
    return f"python -m rf_exp.run task={tasks[next_index % len(tasks)]}"

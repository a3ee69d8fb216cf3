"""Weights & Biases: logs training curves and success rates during a run. Offline by default."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rf_exp import policy  # as a module, to make demonstrations without importing its networks
from rf_exp.ablation import EvaluationRow, GenerationRow
from rf_exp.errors import StageError
from rf_exp.stages.cell import Cell

ResultRow = GenerationRow | EvaluationRow
Log = Callable[[int, Mapping[str, float]], None]
LOGGED_KEYS = (  # keys of the experiment that a run's configuration has too
    *("recipe", "demos", "episodes", "seed", "train_seed", "scenes"),
    *("attempts", "occupancy", "name", "shield"),
)


@contextmanager
def rate_log(
    cell: Cell, stage: str, earlier: Iterable[ResultRow] = ()
) -> Iterator[Callable[[ResultRow], None]]:
    """Context with a function that logs a stage's rates after each row; `earlier`: rows of earlier runs."""
    rates = Rates()
    for result in earlier:
        rates.add(result)

    def add(result: ResultRow) -> None:
        rates.add(result)
        log(rates.rows, rates.figures())

    with run_log(cell, stage) as log:
        yield add


class Rates:
    """Rates over result rows. Every row counts, failed ones too."""

    def __init__(self) -> None:
        self.rows = 0
        self._counts: Counter[str] = Counter()

    def add(self, row: ResultRow) -> None:
        self.rows += 1
        self._counts.update(
            success=row.success,
            success_paper=row.success_paper,
            success_without_violation=row.success and not row.violations,
            with_violation=row.violations > 0,
            violations=row.violations,
            steps=row.steps if row.success else 0,
        )

    def figures(self) -> dict[str, float]:
        """Rates in [0, 1], the mean number of violations of a row, the mean control steps of a success."""
        figures = {name: count / self.rows for name, count in self._counts.items() if name != "steps"}
        if successes := self._counts["success"]:
            figures["steps"] = self._counts["steps"] / successes
        return figures


@contextmanager
def run_log(cell: Cell, stage: str, view: str = "") -> Iterator[Log]:
    """Context with a function that logs figures at a step. The run is made at its first call."""
    experiment = cell.experiment
    if experiment.wandb == "disabled":
        yield lambda step, figures: None
        return
    import wandb  # slow to import, and not needed where it is disabled

    folder, run = experiment.out / "wandb", None
    folder.mkdir(parents=True, exist_ok=True)

    def log(step: int, figures: Mapping[str, float]) -> None:
        nonlocal run
        if run is None:
            try:
                run = wandb.init(
                    project="rf_exp",
                    dir=folder.parent,  # it makes its own folder `wandb` there
                    mode=experiment.wandb,
                    job_type=stage,
                    settings=wandb.Settings(silent=True, console="off"),
                    reinit="create_new",  # policies that train side by side have runs of their own
                    **run_settings(cell, stage, view),
                )
            except wandb.Error as error:
                raise StageError(
                    f"Weights & Biases took no run: {error}; with wandb=offline it stays in {folder}"
                ) from error
        run.log(dict(figures), step=step)

    try:
        yield log
    finally:
        if run is not None:
            run.finish()


def run_settings(cell: Cell, stage: str, view: str = "") -> dict[str, Any]:
    """Name, group, tags and configuration of a run."""
    experiment, arch = cell.experiment, cell.optional_arch
    amount = f"{experiment.learned_from if stage == 'evaluate' else experiment.demos} demos"
    if stage == "generate" and experiment.episodes is not None:
        amount = f"{experiment.episodes} episodes"
    method = [experiment.method] if arch else []
    seed = f"seed {experiment.seed}" if stage == "generate" else f"train seed {experiment.train_seed}"
    shielded = ["shield"] if stage == "evaluate" and experiment.shield else []
    config = {
        "stage": stage,
        "task": cell.task.name,
        "constraints": cell.constraint_set.name,
        "row": asdict(cell.constraint_set),
        "arch": asdict(arch) if arch else None,
        "view": view or None,
        "brain": dict(experiment.brain.identity),
        "criteria_version": cell.task.version,
        "first_scene_seed": experiment.seed if stage == "generate" else experiment.first_scene,
        **{key: getattr(experiment, key) for key in LOGGED_KEYS},
        **{key: asdict(getattr(experiment, key)) for key in ("limits", "pictures", "policy", "training")},
    }
    parts, view_suffix = [*method, amount, seed], f"/{view}" if view else ""
    return {
        "name": ", ".join([f"{stage} {cell.label}{view_suffix}", *parts, *shielded]),
        "group": ", ".join([cell.label, *parts]),
        "tags": [*cell.label.split("/"), *parts, *shielded],
        "config": config,
    }


class Follower:
    """Reads the curves of a policy while another process trains it; every new row goes to `log`."""

    def __init__(self, path: Path, log: Log) -> None:
        self._path, self._log, self._step = path, log, 0
        self._step = max((curve.step for curve in self._rows()), default=0)  # skips those of earlier runs

    def new(self) -> "Iterator[tuple[policy.Curve, int]]":
        """Yields the rows since the last call, each with the number of steps since the row before it."""
        for curve in self._rows():
            steps, self._step = curve.step - self._step, curve.step
            self._log(curve.step, asdict(curve))
            yield curve, steps

    def _rows(self) -> "list[policy.Curve]":
        rows = policy.read_curves(self._path) if self._path.exists() else []
        return [row for row in rows if row.step > self._step]

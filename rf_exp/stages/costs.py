"""How long what is still missing will take, told before it begins: from measured costs of each part."""

from pathlib import Path
from typing import Any

import yaml

from rf_exp.ablation import EvaluationRow, GenerationRow, read_rows
from rf_exp.artifacts import leaves
from rf_exp.experiment import Experiment
from rf_exp.policy import MODEL
from rf_exp.progress import console
from rf_exp.stages.cell import Cell, cells

COSTS = Path(__file__).with_name("costs.yaml")  # benchmarks/costs.py measures them


def say_how_long(experiment: Experiment) -> None:
    """Prints what is foretold, if anything is."""
    if said := foretold(experiment):
        console.print(said)


def foretold(experiment: Experiment) -> str:
    """The hours of each stage in a sentence; empty where nobody has measured, or where little is left."""
    known: dict[str, Any] = yaml.safe_load(COSTS.read_text()).get(experiment.recipe, {})
    if any(task.name not in known.get("tasks", {}) for task in experiment.tasks):
        return ""
    learning_s: dict[str, float] = known["learning_s"]
    policy_s = learning_s["once"]
    said = leaves({"policy": experiment.policy.identity, "training": experiment.training.identity})
    policy_s += sum(step_s * (said.get(key) or 0) for key, step_s in learning_s.items())
    left_s = {"generate": 0.0, "train": 0.0, "evaluate": 0.0}
    for cell in cells(experiment):
        cost = known["tasks"][cell.task.name]
        left_s["generate"] += cost["demonstration_s"] * _demonstrations(cell)
        for learned in map(cell.with_arch, experiment.archs):
            rounds = [learned.after(k) for k in range(experiment.dagger.rounds + 1)]
            left_s["train"] += policy_s * sum(map(_policies, rounds))
            left_s["train"] += cost["scene_s"] * sum(map(_rollouts, rounds[1:]))
            left_s["evaluate"] += cost["scene_s"] * _scenes(learned)
    left_s = {stage: each for stage, each in left_s.items() if each and stage in experiment.stages}
    total_s = sum(left_s.values())
    if total_s < 120:
        return ""
    parts = ", ".join(f"{stage} {_time(each)}" for stage, each in left_s.items())
    workers = f"{experiment.workers} worker{'s' * (experiment.workers > 1)}"
    return f"about {_time(total_s / experiment.workers)} with {workers} ({parts} of one core)"


def _demonstrations(cell: Cell) -> int:
    """Demonstrations, or seeds to try, that are not there yet."""
    tried, wanted = _read(cell.generation_path, GenerationRow), cell.experiment.episodes
    if wanted is not None:
        return max(0, wanted - len(tried))
    return max(0, cell.experiment.demos - sum(each.success for each in tried))


def _policies(cell: Cell) -> int:
    return sum(not (cell.policy_path / view.name / MODEL).exists() for view in cell.views)


def _rollouts(cell: Cell) -> int:
    return max(0, cell.experiment.dagger.rollouts - len(_read(cell.correction_path, GenerationRow)))


def _scenes(cell: Cell) -> int:
    seen, seed = _read(cell.evaluation_path, EvaluationRow), cell.experiment.train_seed
    return max(0, cell.experiment.scenes - sum(each.train_seed == seed for each in seen))


def _read(path: Path, kind: Any) -> tuple[Any, ...]:
    return read_rows(path, kind) if path.exists() else ()


def _time(seconds: float) -> str:
    minutes = max(1, round(seconds / 60))
    return f"{minutes} min" if minutes < 60 else f"{minutes / 60:.1f} h"

"""How long what is still missing will take, told before it begins: from measured costs of each part."""

from itertools import product
from pathlib import Path
from typing import Any

import yaml

from rf_exp.ablation import EvaluationRow, GenerationRow, read_rows
from rf_exp.experiment import Experiment
from rf_exp.policy import MODEL, views
from rf_exp.progress import console
from rf_exp.stages.artifacts import correction_path, evaluation_path, generation_path, policy_path
from rf_exp.tasks import Task
from rf_exp.types import Arch, ConstraintSet

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
    for phase in ("eyes_steps", "draft_steps", "steps"):
        policy_s += learning_s[phase] * (getattr(experiment.training, phase) or 0)
    left_s = {"generate": 0.0, "train": 0.0, "evaluate": 0.0}
    for task, constraint_set in product(experiment.tasks, experiment.constraint_sets):
        cost = known["tasks"][task.name]
        left_s["generate"] += cost["demonstration_s"] * _demonstrations(experiment, task, constraint_set)
        for arch in experiment.archs:
            rounds = [experiment.after(k) for k in range(experiment.dagger.rounds + 1)]
            policies, rollouts = (
                sum(missing(each, task, constraint_set, arch) for each in some)
                for missing, some in ((_policies, rounds), (_rollouts, rounds[1:]))
            )
            left_s["train"] += policy_s * policies + cost["scene_s"] * rollouts
            left_s["evaluate"] += cost["scene_s"] * _scenes(experiment, task, constraint_set, arch)
    left_s = {stage: each for stage, each in left_s.items() if each and stage in experiment.stages}
    total_s = sum(left_s.values())
    if total_s < 120:
        return ""
    parts = ", ".join(f"{stage} {_time(each)}" for stage, each in left_s.items())
    workers = f"{experiment.workers} worker{'s' * (experiment.workers > 1)}"
    return f"about {_time(total_s / experiment.workers)} with {workers} ({parts} of one core)"


def _demonstrations(experiment: Experiment, task: Task, constraint_set: ConstraintSet) -> int:
    """That are not there yet."""
    tried = _read(generation_path(experiment, task, constraint_set), GenerationRow)
    if experiment.episodes is not None:
        return max(0, experiment.episodes - len(tried))
    return max(0, experiment.demos - sum(each.success for each in tried))


def _policies(experiment: Experiment, task: Task, constraint_set: ConstraintSet, arch: Arch) -> int:
    folder = policy_path(experiment, task, constraint_set, arch)
    return sum(not (folder / view.name / MODEL).exists() for view in views(arch, len(task.agents)))


def _rollouts(experiment: Experiment, task: Task, constraint_set: ConstraintSet, arch: Arch) -> int:
    tried = _read(correction_path(experiment, task, constraint_set, arch), GenerationRow)
    return max(0, experiment.dagger.rollouts - len(tried))


def _scenes(experiment: Experiment, task: Task, constraint_set: ConstraintSet, arch: Arch) -> int:
    seen = _read(evaluation_path(experiment, task, constraint_set, arch), EvaluationRow)
    return max(0, experiment.scenes - sum(each.train_seed == experiment.train_seed for each in seen))


def _read(path: Path, kind: Any) -> tuple[Any, ...]:
    return read_rows(path, kind) if path.exists() else ()


def _time(seconds: float) -> str:
    minutes = max(1, round(seconds / 60))
    return f"{minutes} min" if minutes < 60 else f"{minutes / 60:.1f} h"

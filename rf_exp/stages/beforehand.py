"""Checks before any work begins: folders, cameras, and an estimate of the time that missing work will take.

The estimate follows from measured costs of each part.
"""

from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import yaml

from rf_exp.ablation import EvaluationRow, GenerationRow
from rf_exp.artifacts import leaves
from rf_exp.errors import ArgumentError
from rf_exp.experiment import Experiment
from rf_exp.policy import MODEL
from rf_exp.progress import console
from rf_exp.stages.cell import cells, known_rows

COSTS = Path(__file__).with_name("costs.yaml")  # benchmarks/costs.py measures them


def check_folders(experiment: Experiment) -> None:
    """Makes the folders of the chosen stages. Raises ArgumentError naming one that cannot be used."""
    stages, found = set(experiment.stages), {experiment.out}
    for cell in cells(experiment):
        if "generate" in stages:
            found |= {cell.data_path.parent, cell.generation_path.parent}
        looks = {"generate": experiment.recordings, "evaluate": experiment.recordings or experiment.films}
        if any(looks.get(stage) for stage in stages):
            found.add(cell.recording_path("generate", 0).parent)
        for learned in map(cell.with_arch, experiment.archs):
            if "train" in stages:
                found.add(learned.policy_path)
            if "evaluate" in stages:
                found.add(learned.evaluation_path.parent)
    if stages & {"generate", "train", "evaluate"} and experiment.wandb != "disabled":
        found.add(experiment.out / "wandb")
    if "report" in stages:
        found.add(experiment.out / "tables")
    for folder in sorted(found):
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with TemporaryFile(dir=folder):
                pass
        except OSError as error:
            raise ArgumentError(
                f"cannot write below {folder}: {error.strerror}; make way for that folder, choose "
                f"another one with out=FOLDER{', or use wandb=disabled' if folder.name == 'wandb' else ''}"
            ) from error


def check_cameras(experiment: Experiment) -> None:
    """Raises ArgumentError where policies need a camera that makes no pictures."""
    if not {"generate", "train"} <= set(experiment.stages) or not experiment.policy.encoder.pictures:
        return
    for cell in cells(experiment):
        there = experiment.pictures.of(len(cell.task.agents))
        for learned in map(cell.with_arch, experiment.archs):
            streams = (stream for view in learned.views for stream in view.streams)
            missing = {camera for stream in streams for camera in stream.cameras} - {*there}
            if missing and not cell.data_path.exists():  # existing demonstrations may have more
                raise ArgumentError(
                    f"arch={learned.arch.name} looks through {', '.join(sorted(missing))}, and cameras="
                    f"{experiment.pictures.cameras} makes no pictures of it; use cameras=all"
                )


def say_how_long(experiment: Experiment) -> None:
    """Prints the estimate, if there is one."""
    if said := foretold(experiment):
        console.print(said)


def foretold(experiment: Experiment) -> str:
    """The estimated time of each stage in a sentence; empty without measured costs, or below two minutes.

    Tasks without measured costs are named, but not counted.
    """
    known: dict[str, Any] = yaml.safe_load(COSTS.read_text()).get(experiment.recipe, {})
    measured = known.get("tasks", {})
    unknown = [task.name for task in experiment.tasks if task.name not in measured]
    if len(unknown) == len(experiment.tasks):
        return ""
    learning_s: dict[str, float] = known["learning_s"]
    policy_s = learning_s["once"]
    said = leaves({"policy": experiment.policy.identity, "training": experiment.training.identity})
    policy_s += sum(step_s * (said.get(key) or 0) for key, step_s in learning_s.items())
    left_s = {"generate": 0.0, "train": 0.0, "evaluate": 0.0}
    for cell in cells(experiment):
        if cell.task.name in unknown:
            continue
        cost, tried = measured[cell.task.name], known_rows(cell.generation_path, GenerationRow)
        seeds, demos = experiment.episodes, experiment.demos
        left = demos - sum(each.success for each in tried) if seeds is None else seeds - len(tried)
        left_s["generate"] += cost["demonstration_s"] * max(0, left)
        for learned in map(cell.with_arch, experiment.archs):
            rounds = [learned.after(k) for k in range(experiment.dagger.rounds + 1)]
            policies = [now.policy_path / view.name / MODEL for now in rounds for view in now.views]
            left_s["train"] += policy_s * sum(not path.exists() for path in policies)
            for now in rounds[1:]:
                rolled = known_rows(now.correction_path, GenerationRow)
                left_s["train"] += cost["scene_s"] * max(0, experiment.dagger.rollouts - len(rolled))
            seen = [each.train_seed for each in known_rows(learned.evaluation_path, EvaluationRow)]
            missing = experiment.scenes - seen.count(experiment.train_seed)
            left_s["evaluate"] += cost["scene_s"] * max(0, missing)
    left_s = {stage: each for stage, each in left_s.items() if each and stage in experiment.stages}
    total_s = sum(left_s.values())
    if total_s < 120:
        return ""
    parts = ", ".join(f"{stage} {_time(each)}" for stage, each in left_s.items())
    workers = f"{experiment.workers} worker{'s' * (experiment.workers > 1)}"
    beside = f", beside what is not known: {', '.join(unknown)}" if unknown else ""
    return f"about {_time(total_s / experiment.workers)} with {workers} ({parts} of one core){beside}"


def _time(seconds: float) -> str:
    minutes = max(1, round(seconds / 60))
    return f"{minutes} min" if minutes < 60 else f"{minutes / 60:.1f} h"

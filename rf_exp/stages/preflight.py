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
    stages, folders = set(experiment.stages), {experiment.out}
    for cell in cells(experiment):
        if "generate" in stages:
            folders |= {cell.data_path.parent, cell.generation_path.parent}
        wants_recordings = {
            "generate": experiment.recordings,
            "evaluate": experiment.recordings or experiment.films,
        }
        if any(wants_recordings.get(stage) for stage in stages):
            folders.add(cell.recording_path("generate", 0).parent)
        for policy_cell in map(cell.with_arch, experiment.archs):
            if "train" in stages:
                folders.add(policy_cell.policy_path)
            if "evaluate" in stages:
                folders.add(policy_cell.evaluation_path.parent)
    if stages & {"generate", "train", "evaluate"} and experiment.wandb != "disabled":
        folders.add(experiment.out / "wandb")
    if "report" in stages:
        folders.add(experiment.out / "tables")
    for folder in sorted(folders):
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
        rendered = experiment.pictures.camera_names(len(cell.task.agents))
        for policy_cell in map(cell.with_arch, experiment.archs):
            streams = (stream for view in policy_cell.views for stream in view.streams)
            missing = {camera for stream in streams for camera in stream.cameras} - {*rendered}
            if missing and not cell.data_path.exists():  # existing demonstrations may have more
                raise ArgumentError(
                    f"arch={policy_cell.arch.name} looks through {', '.join(sorted(missing))}, and cameras="
                    f"{experiment.pictures.cameras} makes no pictures of it; use cameras=all"
                )


def print_estimate(experiment: Experiment) -> None:
    """Prints the estimate, if there is one."""
    if estimate := estimated_time(experiment):
        console.print(estimate)


def estimated_time(experiment: Experiment) -> str:
    """The estimated time of each stage in a sentence; empty without measured costs, or below two minutes.

    Tasks without measured costs are named, but not counted.
    """
    costs: dict[str, Any] = yaml.safe_load(COSTS.read_text()).get(experiment.recipe, {})
    measured = costs.get("tasks", {})
    unknown = [task.name for task in experiment.tasks if task.name not in measured]
    if len(unknown) == len(experiment.tasks):
        return ""
    training_cost_s: dict[str, float] = costs["learning_s"]
    policy_s = training_cost_s["once"]
    configuration = leaves({"policy": experiment.policy.identity, "training": experiment.training.identity})
    policy_s += sum(step_s * (configuration.get(key) or 0) for key, step_s in training_cost_s.items())
    remaining_s = {"generate": 0.0, "train": 0.0, "evaluate": 0.0}
    for cell in cells(experiment):
        if cell.task.name in unknown:
            continue
        cost, rows = measured[cell.task.name], known_rows(cell.generation_path, GenerationRow)
        seeds, demos = experiment.episodes, experiment.demos
        remaining = demos - sum(each.success for each in rows) if seeds is None else seeds - len(rows)
        remaining_s["generate"] += cost["demonstration_s"] * max(0, remaining)
        for policy_cell in map(cell.with_arch, experiment.archs):
            rounds = [policy_cell.after_rounds(k) for k in range(experiment.dagger.rounds + 1)]
            policies = [
                round_cell.policy_path / view.name / MODEL
                for round_cell in rounds
                for view in round_cell.views
            ]
            remaining_s["train"] += policy_s * sum(not path.exists() for path in policies)
            for round_cell in rounds[1:]:
                corrected = known_rows(round_cell.correction_path, GenerationRow)
                remaining_s["train"] += cost["scene_s"] * max(0, experiment.dagger.rollouts - len(corrected))
            train_seeds = [each.train_seed for each in known_rows(policy_cell.evaluation_path, EvaluationRow)]
            missing = experiment.scenes - train_seeds.count(experiment.train_seed)
            remaining_s["evaluate"] += cost["scene_s"] * max(0, missing)
    remaining_s = {stage: each for stage, each in remaining_s.items() if each and stage in experiment.stages}
    total_s = sum(remaining_s.values())
    if total_s < 120:
        return ""
    parts = ", ".join(f"{stage} {_time(each)}" for stage, each in remaining_s.items())
    workers = f"{experiment.workers} worker{'s' * (experiment.workers > 1)}"
    excluded = f", without tasks of unknown cost: {', '.join(unknown)}" if unknown else ""
    return f"about {_time(total_s / experiment.workers)} with {workers} ({parts} of one core){excluded}"


def _time(seconds: float) -> str:
    minutes = max(1, round(seconds / 60))
    return f"{minutes} min" if minutes < 60 else f"{minutes / 60:.1f} h"

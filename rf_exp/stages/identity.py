"""What decides the bytes of demonstrations and the rows of policies, beside their seeds.

Configuration and assets by their content, code by its versions.
"""

from dataclasses import asdict, replace
from typing import Any

from rf_exp.artifacts.identity import plain, without
from rf_exp.datagen.coordinator import VERSION as COORDINATOR
from rf_exp.datagen.version import generator_version
from rf_exp.experiment import Experiment
from rf_exp.policy.shield import VERSION as SHIELD
from rf_exp.tasks import Task
from rf_exp.types import Arch, Row


def generation_identity(experiment: Experiment, task: Task, row: Row) -> dict[str, Any]:
    """Of the rows of generation. A store adds its first seed and its pictures."""
    settings = experiment.settings(task, row)
    said = {
        **without(asdict(settings), disturbance_rad=0.0, delay_s=0.0),
        "task": task.name,
        "scene": task.identity,
        "version": task.version,
        "generator": generator_version(task),
        "brain": settings.brain.identity,
    }
    if settings.brain.reads:
        said["told"] = [task.title, task.description, task.target_condition]
    if settings.brain.reads or experiment.occupancy == "depth":
        said["seen"] = experiment.pictures
    return plain(said)


def correction_identity(
    experiment: Experiment, task: Task, row: Row, step_limit: int, policies: dict[str, Any]
) -> dict[str, Any]:
    """Of a round of correction of `policies`, which says what they were made of."""
    return plain(
        {
            **generation_identity(experiment, task, row),
            "demos": experiment.demos,
            "rollouts": experiment.dagger.rollouts,
            "step_limit": step_limit,
            "policies": policies,
            "acting": experiment.policy.identity,
        }
    )


def evaluation_identity(
    experiment: Experiment, task: Task, row: Row, arch: Arch, step_limit: int
) -> dict[str, Any]:
    """Of evaluation, but for the policies, of which each training seed has its own."""
    aided: dict[str, Any] = {"shield": SHIELD} if experiment.shield else {}
    if arch.coordinated:  # by plans that are made as those of generation are
        aided["coordinator"] = COORDINATOR
        aided["plans"] = generation_identity(replace(experiment, disturbance_rad=0.0), task, row)
    who = {"policy": experiment.policy.identity, "training": experiment.training.identity}
    if experiment.foreign is not None:
        who = {"foreign": experiment.foreign.identity, "velocity_rad_s": experiment.limits.velocity_rad_s}
    return plain(
        {
            **aided,
            "task": task.name,
            "scene": task.identity,
            "demos": experiment.learned_from,
            "pictures": [experiment.pictures.width, experiment.pictures.height],
            "step_limit": step_limit,
            **who,
        }
    )

"""What decides the bytes of demonstrations and the rows of policies, beside their seeds.

Configuration and assets by their content, code by its versions.
"""

from dataclasses import asdict, replace
from typing import Any

from rf_exp.artifacts import plain, without
from rf_exp.datagen import COORDINATOR_VERSION, generator_version
from rf_exp.experiment import Experiment
from rf_exp.policy import SHIELD_VERSION
from rf_exp.tasks import Task
from rf_exp.types import Arch, ConstraintSet, Pictures


def generation_identity(experiment: Experiment, task: Task, constraint_set: ConstraintSet) -> dict[str, Any]:
    """Of the rows of generation."""
    settings = experiment.settings(task, constraint_set)
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


def store_identity(
    experiment: Experiment, task: Task, constraint_set: ConstraintSet, pictures: Pictures
) -> dict[str, Any]:
    """Of demonstrations that hold those pictures."""
    size = (pictures.height, pictures.width) if pictures.render else (0, 0)
    return {
        **generation_identity(experiment, task, constraint_set),
        **without(asdict(experiment.store), depth=False, segmentation=False),
        "first_seed": experiment.seed,
        "cameras": [*pictures.of(len(task.agents))],
        "picture": [*size],
    }


def correction_identity(
    experiment: Experiment,
    task: Task,
    constraint_set: ConstraintSet,
    step_limit: int,
    policies: dict[str, Any],
) -> dict[str, Any]:
    """Of a round of correction of `policies`, which says what they were made of."""
    return plain(
        {
            **generation_identity(experiment, task, constraint_set),
            "demos": experiment.demos,
            "rollouts": experiment.dagger.rollouts,
            "step_limit": step_limit,
            "policies": policies,
            "acting": experiment.policy.identity,
        }
    )


def evaluation_identity(
    experiment: Experiment, task: Task, constraint_set: ConstraintSet, arch: Arch, step_limit: int
) -> dict[str, Any]:
    """Of evaluation, but for the policies, of which each training seed has its own."""
    aided: dict[str, Any] = {"shield": SHIELD_VERSION} if experiment.shield else {}
    if arch.coordinated:  # by plans that are made as those of generation are
        aided["coordinator"] = COORDINATOR_VERSION
        aided["plans"] = generation_identity(replace(experiment, disturbance_rad=0.0), task, constraint_set)
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

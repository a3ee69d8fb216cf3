"""Scenes without a simulator, made from the start of an episode."""

import numpy as np

from rf_exp.tasks import Task
from rf_exp.types import Scene


def start_scene(task: Task, seed: int) -> Scene:
    """The scene of a seed before anything has moved."""
    start = task.start(seed)
    return Scene(
        step=0,
        qpos=start.qpos,
        qvel=np.zeros_like(start.qpos),
        poses=start.poses,
        speeds=dict.fromkeys(start.poses, 0.0),
        held=(None,) * len(task.robots),
    )

"""Scenes without a simulator, made from the start of an episode."""

from rf_exp.tasks import Task
from rf_exp.types import Scene


def start_scene(task: Task, seed: int) -> Scene:
    """The scene of a seed before anything has moved."""
    return task.start(seed).scene

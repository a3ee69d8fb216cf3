"""The numbers of what is seen in a segmentation, the same ones in all scenes of a task."""

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from rf_exp.tasks.task.task import Task

TABLE = "table"  # with the room around it, and clutter


def labels(task: Task) -> tuple[str, ...]:
    """What the numbers of a segmentation mean: 0 nothing, 1 table, room and clutter, objects, agents."""
    return ("nothing", TABLE, *task.objects, *(f"agent{agent}" for agent in task.agents))


def labelled(
    task: Task, images: Mapping[str, NDArray[np.int32]], bodies: Mapping[str, Iterable[int]]
) -> dict[str, NDArray[np.uint8]]:
    """Camera -> (H, W) index of `labels`, from pictures of a simulator's own numbers and whose these are."""
    number = np.zeros(1 + max(max(found) for found in bodies.values()), np.uint8)
    for label, name in enumerate(labels(task)):
        number[list(bodies.get(name, ()))] = label
    for name in task.clutter:
        number[list(bodies.get(name, ()))] = labels(task).index(TABLE)
    return {name: number[image] for name, image in images.items()}

"""What a store says of its contents, from the task and what its cameras take."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from rf_exp.artifacts import plain
from rf_exp.store import Description
from rf_exp.tasks import Task, labels
from rf_exp.types import CameraModel, Extras, Pictures


def described(task: Task, pictures: Pictures, cameras: Sequence[str], extras: Extras) -> Description:
    """Of demonstrations of `task` that are seen by these cameras."""
    scene = task.start(0).scene
    return Description(
        language={key: getattr(task, key) for key in ("title", "description", "target_condition")},
        conditions=tuple(task.module.conditions(scene, scene, task)),
        world_from_base=[plain(robot.world_from_base) for robot in task.robots],
        camera_models={name: _camera(task, pictures, name) for name in cameras},
        depth=extras.depth,
        labels=labels(task) if extras.segmentation else (),
    )


def _camera(task: Task, pictures: Pictures, name: str) -> dict[str, Any]:
    spec, fov_y_rad = task.cameras[name], float(np.deg2rad(task.cameras[name].fov_deg))
    wrist = spec.mount == "wrist"
    pose = task.parent_from_camera(name)
    model = CameraModel(pictures.width, pictures.height, fov_y_rad, pose)
    return {
        "intrinsics": plain(model.intrinsics),
        "hand_from_camera" if wrist else "world_from_camera": plain(pose),
    }

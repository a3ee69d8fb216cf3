"""The start of an episode, drawn from its seed."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from shapely import MultiPoint

from rf_exp.errors import ArgumentError
from rf_exp.transforms import Matrix, planar
from rf_exp.types import Scene

if TYPE_CHECKING:
    from rf_exp.tasks.task import Task

FINGERS_OPEN_M = 0.04
GAP_M = 0.005  # between objects at the start
_DRAWS = 1000


@dataclass(frozen=True)
class Start:
    """What an episode begins with."""

    seed: int
    qpos: NDArray[np.float64]  # (N, 9) rad, metres
    poses: Mapping[str, Matrix]  # object -> world_from_object
    light: float  # relative brightness
    tints: Mapping[str, NDArray[np.float64]]  # object -> (3,) relative brightness of red, green, blue
    masses_kg: Mapping[str, float]  # object -> its mass

    @property
    def scene(self) -> Scene:
        """As it is measured before anything has moved, known without a simulator."""
        qvel, speeds = np.zeros_like(self.qpos), dict.fromkeys(self.poses, 0.0)
        return Scene(0, self.qpos, qvel, self.poses, speeds, held=(None,) * len(self.qpos))


def start_of(task: "Task", seed: int) -> Start:
    """The start of an episode: a pure function of task and seed.

    Objects that would stand in one another are all drawn again. Raises ArgumentError for ranges
    in which there is no room.
    """
    rng = np.random.default_rng([seed, 0])  # stream 0 of the episode: the scene
    for _ in range(_DRAWS):
        poses = _drawn(task, rng)
        if _roomy(task, poses):
            break
    else:
        raise ArgumentError(
            f"task {task.name!r}, seed {seed}: none of {_DRAWS} draws leaves {GAP_M} m between the "
            "objects; widen their ranges"
        )
    rest = np.array([robot.rest_rad for robot in task.robots])
    noise = rng.normal(0.0, task.randomisation.rest_qpos_rad, rest.shape)
    fingers = np.full((len(task.robots), 2), FINGERS_OPEN_M)
    light = 1.0 + rng.uniform(-task.randomisation.light, task.randomisation.light)
    spread = task.randomisation.colour
    tints = {name: 1.0 + rng.uniform(-spread, spread, 3) for name in task.objects}
    masses_kg = {name: _mass_kg(task, name, rng.uniform()) for name in task.objects}
    return Start(seed, np.hstack([rest + noise, fingers]), poses, light, tints, masses_kg)


def _mass_kg(task: "Task", name: str, draw: float) -> float:
    asset = task.asset(name)
    heaviest_kg = asset.heavy_kg or asset.mass_kg
    return asset.mass_kg + draw * task.randomisation.heavy * (heaviest_kg - asset.mass_kg)


def _drawn(task: "Task", rng: np.random.Generator) -> dict[str, Matrix]:
    poses: dict[str, Matrix] = {}
    for name, spec in task.objects.items():
        local = planar(
            rng.uniform(*spec.x_m),
            rng.uniform(*spec.y_m),
            np.deg2rad(rng.uniform(*spec.yaw_deg)),
            spec.z_m,
        )
        poses[name] = poses[spec.relative_to] @ local if spec.relative_to else local
    return poses


def _roomy(task: "Task", poses: Mapping[str, Matrix]) -> bool:
    """Whether the outlines of objects that share the table are apart. A stack is one outline."""
    outlines = {
        name: MultiPoint(task.asset(name).vertices(pose)[:, :2]).convex_hull
        for name, pose in poses.items()
        if task.asset(name).hulls and not task.objects[name].z_m
    }
    return all(outlines[a].distance(outlines[b]) > GAP_M for a, b in combinations(outlines, 2))

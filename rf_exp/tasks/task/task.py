"""Task: its configuration as frozen values, the starts of its episodes, and its success criteria.

A task is `conf/task/<name>.yaml` (robots, objects, cameras, thresholds) and `rf_exp/tasks/<name>.py` with

    VERSION                       version of the success criteria, stamped on every result row
    PLAN_VERSION                  version of plan and places, which determine the demonstrations
    places(scene, task)           optional: named places on the table
    plan(scene, task)             the scripted RoboBrain's Proposal for the present scene
    conditions(scene, start, task)  strict success as named conditions, all of which must hold; a `Measured`
                                  also holds value and bound
    paper(scene, start, task)     optional: the paper's criterion; by default all conditions at one step
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rf_exp.artifacts import drop_defaults
from rf_exp.errors import ArgumentError
from rf_exp.robots import Arm
from rf_exp.statements import Vocabulary
from rf_exp.tasks import assets
from rf_exp.tasks.task.clutter import Clutter
from rf_exp.tasks.task.specs import CameraSpec, ObjectSpec, Randomisation, RobotSpec, Thresholds
from rf_exp.tasks.task.start import Start, start_of
from rf_exp.tasks.task.variation import NO_VARIATION, Variation, with_clutter, with_scene_factors
from rf_exp.transforms import Matrix, inverse
from rf_exp.types import Calibration, Scene

MIN_BASE_SPREAD_M = 0.2  # least distance of bases across the global view for names like `left`


@dataclass(frozen=True)
class Task:
    """One task of the benchmark, as configured."""

    name: str
    title: str
    description: str
    target_condition: str
    robots: tuple[RobotSpec, ...]
    objects: Mapping[str, ObjectSpec]
    cameras: Mapping[str, CameraSpec]  # global, agent1 .. agentN
    success: Mapping[str, float]  # thresholds that the module reads, units in their names
    randomisation: Randomisation
    step_limit: int = 600  # control steps of an attempt: twice the expert's mean (supplementary B)
    variation: Variation = NO_VARIATION
    clutter: Mapping[str, Clutter] = field(default_factory=dict)  # clutter of one scene
    code: str | None = None  # Python module of plan and success; by default rf_exp.tasks.<name>

    def __post_init__(self) -> None:
        if self.step_limit < 1:
            raise ArgumentError(f"step_limit is {self.step_limit}; expected at least 1 control step")
        object.__setattr__(self, "robots", tuple(self.robots))
        object.__setattr__(self, "success", Thresholds(self.success))
        expected = {"global", *(f"agent{k}" for k in range(1, len(self.robots) + 1))}
        if set(self.cameras) != expected:
            raise ArgumentError(
                f"cameras of task {self.name!r} are {sorted(self.cameras)}; expected {sorted(expected)}"
            )

    @property
    def agents(self) -> tuple[int, ...]:
        return tuple(range(1, len(self.robots) + 1))

    @property
    def dof(self) -> int:
        """Largest number of joints of any arm: the width of rows of measured joints and of commands."""
        return max(robot.model.dof for robot in self.robots)

    @property
    def module(self) -> ModuleType:
        return import_module(self.code or f"rf_exp.tasks.{self.name}")

    @property
    def version(self) -> str:
        """Version of the success criteria; rows of different versions are never mixed."""
        return self.module.VERSION

    @property
    def plan_version(self) -> str:
        """Version of plan and places; demonstrations of different versions are never mixed."""
        return self.module.PLAN_VERSION

    def asset(self, name: str) -> assets.Asset:
        """The asset of an object of this task, or of a piece of clutter."""
        if name in self.clutter:
            return self.clutter[name].asset
        spec = self.objects[name]
        return assets.load(spec.asset, spec.options).scaled(spec.size)

    @cached_property
    def arms(self) -> Mapping[int, Arm]:
        """Agent -> its arm, at its base pose."""
        return {k: Arm(robot.model, robot.world_from_base) for k, robot in enumerate(self.robots, start=1)}

    @cached_property
    def points(self) -> Mapping[str, Mapping[str, Matrix]]:
        """Object -> interaction point -> `object_from_tcp`, for success criteria."""
        return {
            name: {label: point.object_from_tcp for label, point in self.asset(name).points.items()}
            for name in self.objects
        }

    def hinged_poses(
        self, name: str, poses: Mapping[str, Matrix], hinge_rad: ArrayLike
    ) -> NDArray[np.float64]:
        """world_from_object (..., 4, 4) of a hinged object at angles (...), its bearer as in `poses`."""
        return self._closed_pose(name, poses) @ self._hinge(name).closed_from_object(hinge_rad)

    def hinge_rad(self, name: str, poses: Mapping[str, Matrix]) -> NDArray[np.float64]:
        """Opening angles (...) of a hinged object whose poses in `poses` are (..., 4, 4)."""
        return self._hinge(name).angle_rad(inverse(self._closed_pose(name, poses)) @ poses[name])

    def _hinge(self, name: str) -> assets.Hinge:
        hinge = self.asset(name).hinge
        assert hinge is not None  # only called for hinged objects
        return hinge

    def _closed_pose(self, name: str, poses: Mapping[str, Matrix]) -> Matrix:
        """world_from_object of a hinged object when closed."""
        spec = self.objects[name]
        return poses[spec.relative_to or ""] @ spec.nominal

    @cached_property
    def vocabulary(self) -> Vocabulary:
        """Names that sentences about this task may use: agents, sides, objects and points."""
        points = {
            name: {label: point.kind for label, point in self.asset(name).points.items()}
            for name in self.objects
        }
        return Vocabulary(self.agents, points, self._sides)

    @property
    def _sides(self) -> dict[str, int]:
        """Side (left, middle, right) -> agent, as seen by the global camera; empty where ambiguous."""
        named = {2: ("left", "right"), 3: ("left", "middle", "right")}.get(len(self.robots))
        camera = self.cameras["global"]
        if named is None or camera.mount != "world":
            return {}
        camera_from_world = inverse(camera.world_from_camera)
        across = [float((camera_from_world @ robot.world_from_base)[0, 3]) for robot in self.robots]
        agents = sorted(self.agents, key=lambda agent: across[agent - 1])
        if min(np.diff(sorted(across))) < MIN_BASE_SPREAD_M:
            return {}
        return dict(zip(named, agents, strict=True))

    @property
    def identity(self) -> dict[str, Any]:
        """Identity: all that determines the task's scenes, their pictures and success.

        Assets enter by their content, code by its versions. Titles and descriptions are left out.
        """
        objects: dict[str, dict[str, Any]] = {}
        for name, spec in self.objects.items():
            objects[name] = drop_defaults(asdict(spec), open_deg=0.0)  # the default is left out
            del objects[name]["options"], objects[name]["size"]  # part of the content
            objects[name]["asset"] = f"{self.asset(name).name} {self.asset(name).content_digest}"
        identity = {
            "robots": tuple(robot.identity for robot in self.robots),
            "cameras": {name: camera.identity for name, camera in self.cameras.items()},
            "success": dict(self.success),
            "randomisation": asdict(self.randomisation),
            "objects": objects,
            "order": list(objects),  # order of their draws
            "criteria": self.version,
            "plan": self.plan_version,
            "variation": self.variation.identity,
        }
        return drop_defaults(identity, variation={})

    def parent_from_camera(self, name: str) -> Matrix:
        """(4, 4) pose of a camera in the world or, for a wrist camera, in the hand frame; OpenCV axes."""
        camera = self.cameras[name]
        if camera.mount == "world":
            return camera.world_from_camera
        return self.robots[int(name.removeprefix("agent")) - 1].model.hand.from_camera

    def calibration(self, cameras: Sequence[str], size_px: tuple[int, int]) -> Calibration:
        """Calibration of the arms and of these cameras, for pictures of (width, height).

        Raises ArgumentError for a wrist camera.
        """
        if wrist_cameras := [name for name in cameras if self.cameras[name].mount != "world"]:
            raise ArgumentError(f"camera {wrist_cameras[0]!r} moves with a hand: it has no place of its own")
        specs = {name: self.cameras[name] for name in cameras}
        models = {name: spec.model(spec.world_from_camera, size_px) for name, spec in specs.items()}
        return Calibration(tuple(robot.world_from_base for robot in self.robots), models)

    def places(self, scene: Scene) -> Mapping[str, Matrix]:
        """Named places: world_from_object (4, 4) of an object put there."""
        named = getattr(self.module, "places", None)
        return named(scene, self) if named else {}

    def in_scene(self, seed: int, copy: int = 0) -> "Task":
        """The task in the scene of a seed and copy, its variation applied; itself where nothing varies."""
        if (seed, copy) not in self._scenes:
            scene_task = with_scene_factors(self, seed, copy)
            if self.variation.clutter[1]:
                scene_task = with_clutter(scene_task, start_of(scene_task, seed).scene, seed)
            self._scenes.clear()  # an episode needs one scene, several times
            self._scenes[seed, copy] = scene_task
        return self._scenes[seed, copy]

    @cached_property
    def _scenes(self) -> "dict[tuple[int, int], Task]":
        """Cache of `in_scene`: the last scene."""
        return {}

    def start(self, seed: int, copy: int = 0) -> Start:
        """The start of the episode of a seed. Raises ArgumentError as `start_of`."""
        return start_of(self.in_scene(seed, copy), seed, copy)


def label_names(task: Task) -> tuple[str, ...]:
    """Names of segmentation labels: 0 nothing, 1 table, floor, walls and clutter, then objects, agents."""
    return ("nothing", "table", *task.objects, *(f"agent{agent}" for agent in task.agents))


def label_images(
    task: Task, images: Mapping[str, NDArray[np.int32]], bodies: Mapping[str, Iterable[int]]
) -> dict[str, NDArray[np.uint8]]:
    """Camera -> (H, W) index into `label_names`, from a simulator's segmentation and the ids of each body."""
    label_of_body = np.zeros(1 + max(max(ids) for ids in bodies.values()), np.uint8)
    for label, name in enumerate(label_names(task)):
        label_of_body[list(bodies.get(name, ()))] = label
    for name in task.clutter:
        label_of_body[list(bodies.get(name, ()))] = label_names(task).index("table")
    return {name: label_of_body[image] for name, image in images.items()}

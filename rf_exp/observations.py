"""Observations: what a controller gets of a scene, which is exactly what it declares.

A `Declaration` names agents, objects and cameras; `observe` makes a frozen `Observation` of them. Policies of
the suite declare what their view and recipe need. Environments and foreign policies declare by `Observations`
and get a dictionary with the keys of the store: `qpos` and `qvel`, `pose_<object>`, `rgb_<camera>`; then
`depth_<camera>`, `segmentation_<camera>`, `world_from_base`, `world_from_camera_<camera>`,
`intrinsics_<camera>` and `language`.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Literal, Protocol, TypeVar, get_args, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from rf_exp.errors import ArgumentError, StageError, unknown_choice
from rf_exp.tasks import Task, label_images
from rf_exp.transforms import position_and_quaternion
from rf_exp.types import Calibration, CameraChoice, CameraModel, Pictures, Scene, World, camera_names

State = Literal["full", "joints", "none"]
IMAGES = ("pictures", "depth", "segmentation")  # kinds of camera image

ObservationDict = dict[str, Any]  # key -> array, or a string for `language`
# From a coordinator: number of each agent's subgoal (N,), and whether the agent may proceed (N,).
Coordination = tuple[NDArray[np.int64], NDArray[np.bool_]]
Key = TypeVar("Key", int, str)


@dataclass(frozen=True)
class Declaration:
    """The observations that a controller needs."""

    agents: tuple[int, ...] = ()  # whose joint positions are measured
    velocities: bool = False  # joint velocities too
    objects: tuple[str, ...] = ()  # whose true poses are given
    cameras: tuple[str, ...] = ()
    pictures: bool = True  # RGB of `cameras`
    depth: bool = False
    segmentation: bool = False
    language: str = ""  # the task, in a sentence or two
    coordinated: tuple[int, ...] = ()  # agents whose subgoals a coordinator gives
    calibrated: bool = False  # poses of the robot bases and of `cameras`
    nominal_calibration: Calibration | None = None  # given where the true one is unknown


@dataclass(frozen=True)
class Observation:
    """The observation at one control step. Fields that were not declared are empty; arrays are read-only."""

    step: int
    qpos: Mapping[int, NDArray[np.float64]] = field(default_factory=dict)  # agent -> (D,) rad, fingers m
    qvel: Mapping[int, NDArray[np.float64]] = field(default_factory=dict)  # agent -> (D,)
    poses: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)  # -> world_from_object (4, 4)
    pictures: Mapping[str, NDArray[np.uint8]] = field(default_factory=dict)  # camera -> (H, W, 3)
    depth: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)  # camera -> (H, W) m
    segmentation: Mapping[str, NDArray[np.uint8]] = field(default_factory=dict)  # camera -> (H, W)
    language: str = ""
    # agent -> (number of its subgoal, whether it may proceed); None without a coordinator
    subgoals: Mapping[int, tuple[int, bool]] | None = None
    calibration: Calibration | None = None  # None: not declared, or not given by the world


@dataclass(frozen=True)
class Observations:
    """The observations of a controller of all arms. Raises ArgumentError for values that are not possible.

    `state`: `full` is all joints and the poses of all objects, `joints` the joints alone, `none` neither.
    `pictures`, `depth` and `segmentation` are images of `cameras`, of `width` x `height` px; without them
    nothing is rendered, and no Vulkan device is needed. `calibration` gives the poses of arms and cameras, or
    the nominal ones if `variation.calibration` is `unknown`.
    """

    state: State = "full"
    pictures: bool = False  # (H, W, 3) uint8, RGB
    depth: bool = False  # (H, W) float32, m along the viewing direction, to the millimetre; 0: nothing there
    segmentation: bool = False  # (H, W) uint8, indices of `labels`
    calibration: bool = False  # (4, 4) float32 poses in the world, m, OpenCV axes; (3, 3) intrinsics, px
    language: bool = False  # the task, in a sentence or two
    cameras: CameraChoice = "all"  # all | local (those of the agents) | global
    width: int = 320
    height: int = 240

    def __post_init__(self) -> None:
        if self.state not in get_args(State):
            raise unknown_choice("state", self.state, get_args(State))
        Pictures(self.width, self.height, self.needs_rendering, self.cameras)  # checks its arguments
        if self.state == "none" and not (self.needs_rendering or self.calibration or self.language):
            raise ArgumentError(
                "nothing is observed; expected state, pictures, depth, segmentation, calibration or language"
            )
        if self.calibration and not self.needs_rendering:
            raise ArgumentError(
                "calibration is observed, and no camera is; expected pictures, depth or segmentation"
            )

    @property
    def needs_rendering(self) -> bool:
        """Whether cameras have to render."""
        return self.pictures or self.depth or self.segmentation

    def declaration_for(self, task: Task) -> Declaration:
        """The declaration for the agents, objects and cameras of a task.

        Raises ArgumentError where the calibration is unknown and a camera has no nominal pose.
        """
        cameras = tuple(camera_names(self.cameras, len(task.agents))) if self.needs_rendering else ()
        unknown = self.calibration and task.variation.calibration == "unknown"
        return Declaration(
            agents=task.agents if self.state != "none" else (),
            velocities=self.state != "none",
            objects=tuple(task.objects) if self.state == "full" else (),
            cameras=cameras,
            **{kind: getattr(self, kind) for kind in IMAGES},
            language=task.description if self.language else "",
            calibrated=self.calibration,
            nominal_calibration=task.calibration(cameras, (self.width, self.height)) if unknown else None,
        )

    def as_dict(self, observation: Observation) -> ObservationDict:
        """The observation as a dictionary with the keys of the store; all arrays are copies."""
        result = ObservationDict()
        if self.state != "none":
            result["qpos"] = np.stack([*observation.qpos.values()]).astype(np.float32)
            result["qvel"] = np.stack([*observation.qvel.values()]).astype(np.float32)
        for name, pose in observation.poses.items():
            result[f"pose_{name}"] = np.array(position_and_quaternion(pose), np.float32)
        for key, kind in zip(("rgb", "depth", "segmentation"), IMAGES, strict=True):
            result |= {f"{key}_{name}": image.copy() for name, image in getattr(observation, kind).items()}
        if (calibration := observation.calibration) is not None:
            result["world_from_base"] = np.stack(calibration.world_from_base).astype(np.float32)
            for name, camera in calibration.cameras.items():
                result[f"world_from_camera_{name}"] = camera.world_from_camera.astype(np.float32)
                result[f"intrinsics_{name}"] = camera.intrinsics.astype(np.float32)
        if self.language:
            result["language"] = observation.language
        return result


@runtime_checkable
class MeasuredWorld(World, Protocol):
    """A world whose cameras also give depth and segmentation (implemented by `rf_exp.sim`)."""

    @property
    def task(self) -> Task: ...

    def depth(self, cameras: Iterable[str] | None = None) -> dict[str, NDArray[np.float32]]: ...

    def segmentation(self, cameras: Iterable[str] | None = None) -> dict[str, NDArray[np.int32]]: ...

    def camera_models(self) -> dict[str, CameraModel]: ...

    def bodies(self) -> dict[str, tuple[int, ...]]:
        """Label of `labels` -> ids of its bodies in a segmentation."""
        ...


def observe(
    scene: Scene, world: World, declarations: Sequence[Declaration], coordination: Coordination | None = None
) -> list[Observation]:
    """The observations of several controllers at the current step. Cameras render only what is declared.

    Raises StageError where depth or segmentation is declared and the world cannot give it.
    """
    images = {kind: _images(kind, world, declarations) for kind in IMAGES}
    return [_observation(scene, world, images, declaration, coordination) for declaration in declarations]


def _calibration(world: World, declaration: Declaration) -> Calibration | None:
    """Calibration of the arms and the declared cameras of a world; the nominal one if it is unknown."""
    if not declaration.calibrated or not isinstance(world, MeasuredWorld):
        return None
    if world.task.variation.calibration == "unknown":
        return declaration.nominal_calibration
    cameras = world.camera_models()
    bases = _copies(dict(enumerate(robot.world_from_base for robot in world.task.robots)))
    camera_poses = _copies({name: cameras[name].world_from_camera for name in declaration.cameras})
    camera_models = {
        name: replace(cameras[name], world_from_camera=pose) for name, pose in camera_poses.items()
    }
    return Calibration(tuple(bases.values()), camera_models)


def _images(kind: str, world: World, declarations: Sequence[Declaration]) -> Mapping[str, NDArray]:
    """Camera -> image of a kind, for the cameras of which a controller declares that kind."""
    names = sorted({camera for each in declarations if getattr(each, kind) for camera in each.cameras})
    if not names:
        return {}
    if kind == "pictures":
        return world.images(names)
    if not isinstance(world, MeasuredWorld):
        raise StageError(f"a policy needs {kind}; the world has pictures alone")
    if kind == "depth":
        return world.depth(names)
    return label_images(world.task, world.segmentation(names), world.bodies())


def _observation(
    scene: Scene,
    world: World,
    images: Mapping[str, Mapping[str, NDArray]],
    declaration: Declaration,
    coordination: Coordination | None,
) -> Observation:
    agents, subgoals, pictures = declaration.agents, None, {}
    if coordination is not None and declaration.coordinated:
        numbers, may_proceed = coordination
        current = {k: (int(numbers[k - 1]), bool(may_proceed[k - 1])) for k in declaration.coordinated}
        subgoals = MappingProxyType(current)
    for kind, arrays in images.items():
        pictures[kind] = _views(
            {name: arrays[name] for name in declaration.cameras if getattr(declaration, kind)}
        )
    return Observation(
        scene.step,
        _copies({agent: scene.qpos[agent - 1] for agent in agents}),
        _copies({agent: scene.qvel[agent - 1] for agent in agents if declaration.velocities}),
        _copies({name: scene.poses[name] for name in declaration.objects}),
        **pictures,
        language=declaration.language,
        subgoals=subgoals,
        calibration=_calibration(world, declaration),
    )


def _copies(arrays: Mapping[Key, NDArray]) -> Mapping[Key, NDArray]:
    """Read-only copies, which share no memory with the originals."""
    return _views({key: array.copy() for key, array in arrays.items()})


def _views(arrays: Mapping[Key, NDArray]) -> Mapping[Key, NDArray]:
    """The same arrays, read-only."""
    views = {key: array.view() for key, array in arrays.items()}
    for array in views.values():
        array.flags.writeable = False
    return MappingProxyType(views)

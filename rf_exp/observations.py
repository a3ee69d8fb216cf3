"""Observations: what a controller is handed of a scene, which is what it declares, and nothing else.

A `Declaration` names whose joints, which objects and which cameras; `observe` makes a frozen `Observation`
of that. Policies of the suite declare what their view and recipe need. Environments and policies of others
declare by `Observations`, and are given a dictionary with the keys of the store: `qpos` and `qvel`,
`pose_<object>`, `rgb_<camera>`; then `depth_<camera>`, `segmentation_<camera>`, `world_from_base`,
`world_from_camera_<camera>`, `intrinsics_<camera>` and `language`.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Literal, Protocol, TypeVar, get_args, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from rf_exp.errors import ArgumentError, StageError, choices
from rf_exp.tasks import Task, labelled
from rf_exp.transforms import position_and_quaternion
from rf_exp.types import Calibration, CameraChoice, CameraModel, Pictures, Scene, World, camera_names

State = Literal["full", "joints", "none"]
IMAGES = ("pictures", "depth", "segmentation")  # that cameras take

ObservationDict = dict[str, Any]  # key -> array, or a string for `language`
# Numbers of the subgoals (N,) and who may go on (N,), as a coordinator says.
Coordination = tuple[NDArray[np.int64], NDArray[np.bool_]]
Key = TypeVar("Key", int, str)


@dataclass(frozen=True)
class Declaration:
    """What a controller declares that it observes."""

    agents: tuple[int, ...] = ()  # whose measured joints
    velocities: bool = False  # of these joints
    objects: tuple[str, ...] = ()  # whose true poses
    cameras: tuple[str, ...] = ()
    pictures: bool = True  # what its cameras take
    depth: bool = False
    segmentation: bool = False
    language: str = ""  # the task, in a sentence or two
    coordinated: tuple[int, ...] = ()  # agents of which a coordinator says what they are to do
    calibrated: bool = False  # where the arms stand, and its cameras, if that is known,
    usual: Calibration | None = None  # and what it is handed of that where nobody knows


@dataclass(frozen=True)
class Observation:
    """What is handed out at one control step. What is not declared is not in it; arrays are read-only."""

    step: int
    qpos: Mapping[int, NDArray[np.float64]] = field(default_factory=dict)  # agent -> (9,) rad, fingers m
    qvel: Mapping[int, NDArray[np.float64]] = field(default_factory=dict)  # agent -> (9,)
    poses: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)  # -> world_from_object (4, 4)
    pictures: Mapping[str, NDArray[np.uint8]] = field(default_factory=dict)  # camera -> (H, W, 3)
    depth: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)  # camera -> (H, W) m
    segmentation: Mapping[str, NDArray[np.uint8]] = field(default_factory=dict)  # camera -> (H, W)
    language: str = ""
    # agent -> number of its subgoal and whether it may go on; None without a coordinator
    subgoals: Mapping[int, tuple[int, bool]] | None = None
    calibration: Calibration | None = None  # None: nobody says


@dataclass(frozen=True)
class Observations:
    """What a controller of all arms is shown. Raises ArgumentError for values that are not possible.

    `state`: `full` is all joints and the poses of all objects, `joints` what an arm measures of itself,
    `none` neither. `pictures`, `depth` and `segmentation` are taken by `cameras`, as `width` x `height` px;
    without them nothing is drawn, and no Vulkan device is needed. `calibration` says where arms and cameras
    stand, or where they usually do if `variation.calibration` is `unknown`.
    """

    state: State = "full"
    pictures: bool = False  # (H, W, 3) uint8, RGB
    depth: bool = False  # (H, W) float32, metres along the viewing direction, to the millimetre; 0 is nothing
    segmentation: bool = False  # (H, W) uint8, numbers of `labels`
    calibration: bool = False  # (4, 4) float32 poses in the world, m, OpenCV axes; (3, 3) of pixels
    language: bool = False  # the task, in a sentence or two
    cameras: CameraChoice = "all"  # all | local (those of the agents) | global
    width: int = 320
    height: int = 240

    def __post_init__(self) -> None:
        if self.state not in get_args(State):
            raise choices("state", self.state, get_args(State))
        Pictures(self.width, self.height, self.draws, self.cameras)  # looks at its arguments
        if self.state == "none" and not (self.draws or self.calibration or self.language):
            raise ArgumentError(
                "nothing is observed; expected state, pictures, depth, segmentation, calibration or language"
            )
        if self.calibration and not self.draws:
            raise ArgumentError(
                "calibration is observed, and no camera is; expected pictures, depth or segmentation"
            )

    @property
    def draws(self) -> bool:
        """Whether a camera has to look."""
        return self.pictures or self.depth or self.segmentation

    def declared(self, task: Task) -> Declaration:
        """The same for the agents, objects and cameras of a task.

        Raises ArgumentError where a calibration is asked for that has no usual one.
        """
        cameras = tuple(camera_names(self.cameras, len(task.agents))) if self.draws else ()
        unknown = self.calibration and task.variation.calibration == "unknown"
        return Declaration(
            agents=task.agents if self.state != "none" else (),
            velocities=self.state != "none",
            objects=tuple(task.objects) if self.state == "full" else (),
            cameras=cameras,
            **{kind: getattr(self, kind) for kind in IMAGES},
            language=task.description if self.language else "",
            calibrated=self.calibration,
            usual=task.calibration(cameras, (self.width, self.height)) if unknown else None,
        )

    def keyed(self, observation: Observation) -> ObservationDict:
        """What is shown of an observation, by the keys of the store; all arrays are new ones."""
        shown = ObservationDict()
        if self.state != "none":
            shown["qpos"] = np.stack([*observation.qpos.values()]).astype(np.float32)
            shown["qvel"] = np.stack([*observation.qvel.values()]).astype(np.float32)
        for name, pose in observation.poses.items():
            shown[f"pose_{name}"] = np.array(position_and_quaternion(pose), np.float32)
        for key, kind in zip(("rgb", "depth", "segmentation"), IMAGES, strict=True):
            shown |= {f"{key}_{name}": image.copy() for name, image in getattr(observation, kind).items()}
        if (stands := observation.calibration) is not None:
            shown["world_from_base"] = np.stack(stands.world_from_base).astype(np.float32)
            for name, camera in stands.cameras.items():
                shown[f"world_from_camera_{name}"] = camera.world_from_camera.astype(np.float32)
                shown[f"intrinsics_{name}"] = camera.intrinsics.astype(np.float32)
        if self.language:
            shown["language"] = observation.language
        return shown


@runtime_checkable
class MeasuredWorld(World, Protocol):
    """A world whose cameras also give depth and what is where (given by `rf_exp.sim`)."""

    @property
    def task(self) -> Task: ...

    def depth(self, cameras: Iterable[str] | None = None) -> dict[str, NDArray[np.float32]]: ...

    def segmentation(self, cameras: Iterable[str] | None = None) -> dict[str, NDArray[np.int32]]: ...

    def camera_models(self) -> dict[str, CameraModel]: ...

    def bodies(self) -> dict[str, tuple[int, ...]]:
        """Body of `labels` -> its numbers in a segmentation."""
        ...


def observe(
    scene: Scene, world: World, declared: Sequence[Declaration], coordination: Coordination | None = None
) -> list[Observation]:
    """What each of several controllers is handed of the present step. A camera takes what somebody asks for.

    Raises StageError where depth or segmentation is declared and the world cannot give it.
    """
    images = {kind: _images(kind, world, declared) for kind in IMAGES}
    return [_handed(scene, world, images, each, coordination) for each in declared]


def _calibration(world: World, declared: Declaration) -> Calibration | None:
    """Where the arms of a world stand, and the declared cameras; if that is unknown, what is usual."""
    if not declared.calibrated or not isinstance(world, MeasuredWorld):
        return None
    if world.task.variation.calibration == "unknown":
        return declared.usual
    cameras = world.camera_models()
    bases = _copies(dict(enumerate(robot.world_from_base for robot in world.task.robots)))
    eyes = _copies({name: cameras[name].world_from_camera for name in declared.cameras})
    seen = {name: replace(cameras[name], world_from_camera=pose) for name, pose in eyes.items()}
    return Calibration(tuple(bases.values()), seen)


def _images(kind: str, world: World, declared: Sequence[Declaration]) -> Mapping[str, NDArray]:
    """Camera -> image of a kind, of those cameras that somebody looks through for it."""
    wanted = sorted({camera for each in declared if getattr(each, kind) for camera in each.cameras})
    if not wanted:
        return {}
    if kind == "pictures":
        return world.images(wanted)
    if not isinstance(world, MeasuredWorld):
        raise StageError(f"a policy needs {kind}; the world has pictures alone")
    if kind == "depth":
        return world.depth(wanted)
    return labelled(world.task, world.segmentation(wanted), world.bodies())


def _handed(
    scene: Scene,
    world: World,
    images: Mapping[str, Mapping[str, NDArray]],
    declared: Declaration,
    coordination: Coordination | None,
) -> Observation:
    agents, subgoals, pictures = declared.agents, None, {}
    if coordination is not None and declared.coordinated:
        numbers, may_go = coordination
        told = {k: (int(numbers[k - 1]), bool(may_go[k - 1])) for k in declared.coordinated}
        subgoals = MappingProxyType(told)
    for kind, taken in images.items():
        pictures[kind] = _views({each: taken[each] for each in declared.cameras if getattr(declared, kind)})
    return Observation(
        scene.step,
        _copies({agent: scene.qpos[agent - 1] for agent in agents}),
        _copies({agent: scene.qvel[agent - 1] for agent in agents if declared.velocities}),
        _copies({name: scene.poses[name] for name in declared.objects}),
        **pictures,
        language=declared.language,
        subgoals=subgoals,
        calibration=_calibration(world, declared),
    )


def _copies(arrays: Mapping[Key, NDArray]) -> Mapping[Key, NDArray]:
    """Copies, from which no way leads back to what they were cut out of."""
    return _views({key: array.copy() for key, array in arrays.items()})


def _views(arrays: Mapping[Key, NDArray]) -> Mapping[Key, NDArray]:
    """The same arrays, read-only."""
    found = {key: array.view() for key, array in arrays.items()}
    for array in found.values():
        array.flags.writeable = False
    return MappingProxyType(found)

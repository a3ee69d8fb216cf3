"""What a task is: its configuration as frozen values, its starts, and how success is judged.

A task is `conf/task/<name>.yaml` (what stands where) and `rf_exp/tasks/<name>.py` with

    VERSION                       of its success criteria, stamped on every result row
    PLAN_VERSION                  of its plan and places: of what it does for the demonstrations
    places(scene, task)           optional: named places on the table
    plan(scene, task)             the scripted RoboBrain's Proposal from the present scene
    conditions(scene, start, task)  strict success as named conditions, all of which must hold; one that
                                  is a `Measured` also says by how much
    paper(scene, start, task)     the paper's criterion
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from importlib import import_module
from itertools import combinations
from math import hypot
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from shapely import MultiPoint

from rf_exp.errors import ArgumentError
from rf_exp.statements import Vocabulary
from rf_exp.tasks import assets
from rf_exp.transforms import Matrix, from_axes, inverse, planar
from rf_exp.types import ARM_JOINTS, Condition, Measured, Scene, Verdict

REST_QPOS = (0.0, np.pi / 8, 0.0, -5 * np.pi / 8, 0.0, 3 * np.pi / 4, np.pi / 4)  # rad
ASIDE_QPOS = (0.0, -0.6, 0.0, -2.5, 0.0, 1.9, np.pi / 4)  # rad, pulled in over its own base
FINGERS_OPEN_M = 0.04
GAP_M = 0.005  # between objects at the start
REACH_M = 0.855  # of a Panda from its base (its data sheet)
OFF_M = 0.05  # below the top of the table
DROP_M = 0.05  # that a thing falls after it was let go; what is set down sinks by millimetres
APART_M = 0.2  # that bases lie side by side in a picture, to be told by their sides
_DRAWS = 1000


@dataclass(frozen=True)
class RobotSpec:
    """Where an arm is bolted to the table, and how it stands when it has nothing to do."""

    x_m: float
    y_m: float
    yaw_deg: float
    rest_rad: tuple[float, ...] = REST_QPOS  # (7,)

    def __post_init__(self) -> None:
        object.__setattr__(self, "rest_rad", tuple(map(float, self.rest_rad)))
        if len(self.rest_rad) != ARM_JOINTS:
            raise ArgumentError(f"rest_rad has {len(self.rest_rad)} values; an arm has {ARM_JOINTS} joints")

    @cached_property
    def world_from_base(self) -> Matrix:
        return planar(self.x_m, self.y_m, np.deg2rad(self.yaw_deg))


@dataclass(frozen=True)
class ObjectSpec:
    """An object and the ranges its start is drawn from, uniform for each axis."""

    asset: str
    x_m: tuple[float, float] = (0.0, 0.0)
    y_m: tuple[float, float] = (0.0, 0.0)
    z_m: float = 0.0
    yaw_deg: tuple[float, float] = (0.0, 0.0)
    relative_to: str | None = None  # another object: x, y, yaw count from its pose, z from its origin
    options: Mapping[str, Any] = field(default_factory=dict)  # of the asset, e.g. its colour

    def __post_init__(self) -> None:
        for axis in ("x_m", "y_m", "yaw_deg"):
            value = getattr(self, axis)
            low, high = value if isinstance(value, list | tuple) else (value, value)
            if low > high:
                raise ArgumentError(
                    f"{axis} of asset {self.asset!r}: range [{low}, {high}] is the wrong way round; "
                    f"write [{high}, {low}]"
                )
            object.__setattr__(self, axis, (float(low), float(high)))


@dataclass(frozen=True)
class CameraSpec:
    """A pinhole camera. With `mount: wrist` it rides on the hand of its agent instead."""

    eye_m: tuple[float, float, float] = (0.0, 0.0, 1.0)
    target_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    fov_deg: float = 90.0  # vertical
    mount: str = "world"  # world | wrist

    def __post_init__(self) -> None:
        if self.mount not in ("world", "wrist"):
            raise ArgumentError(f"camera mount {self.mount!r}; available: world, wrist")
        object.__setattr__(self, "eye_m", tuple(self.eye_m))
        object.__setattr__(self, "target_m", tuple(self.target_m))

    @cached_property
    def world_from_camera(self) -> Matrix:
        """(4, 4) of a camera that stands in the world: x right, y down, z forward (OpenCV)."""
        forward = np.subtract(self.target_m, self.eye_m)
        upright = (0, 0, -1) if np.hypot(*forward[:2]) > 1e-6 else (-1, 0, 0)  # straight down: +x is up
        return from_axes(self.eye_m, z=forward, y=upright)


@dataclass(frozen=True)
class Randomisation:
    """Changes of what is seen, of the rest pose and of weights, drawn from the episode's seed."""

    rest_qpos_rad: float = 0.02  # standard deviation on each joint
    light: float = 0.1  # half range of the relative brightness
    colour: float = 0.1  # half range of the relative brightness of each primary colour of each object
    heavy: float = 0.0  # masses are uniform from the asset's up to this part of the way to its heaviest make

    def __post_init__(self) -> None:
        if not 0 <= self.rest_qpos_rad < np.inf:
            raise ArgumentError(f"randomisation.rest_qpos_rad is {self.rest_qpos_rad}; expected 0 or more")
        for name in ("light", "colour", "heavy"):
            if not 0 <= (value := getattr(self, name)) <= 1:
                raise ArgumentError(f"randomisation.{name} is {value}; expected a number from 0 to 1")


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
    randomisation: Randomisation = Randomisation()
    step_limit: int = 600  # control steps after which an attempt in an environment is over
    code: str | None = None  # Python module of plan and success; rf_exp.tasks.<name> unless given

    def __post_init__(self) -> None:
        if self.step_limit < 1:
            raise ArgumentError(f"step_limit is {self.step_limit}; expected at least 1 control step")
        object.__setattr__(self, "robots", tuple(self.robots))
        expected = {"global", *(f"agent{k}" for k in range(1, len(self.robots) + 1))}
        if set(self.cameras) != expected:
            raise ArgumentError(
                f"cameras of task {self.name!r} are {sorted(self.cameras)}; expected {sorted(expected)}"
            )

    @property
    def agents(self) -> tuple[int, ...]:
        return tuple(range(1, len(self.robots) + 1))

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
        """The asset of an object of this task."""
        spec = self.objects[name]
        return assets.load(spec.asset, spec.options)

    @cached_property
    def vocabulary(self) -> Vocabulary:
        """What sentences about it may speak of."""
        points = {
            name: {label: point.kind for label, point in self.asset(name).points.items()}
            for name in self.objects
        }
        return Vocabulary(self.agents, points, self._sides)

    @property
    def _sides(self) -> dict[str, int]:
        """Which agent is called the left one, and so on: as the global camera sees their bases."""
        named = {2: ("left", "right"), 3: ("left", "middle", "right")}.get(len(self.robots))
        camera = self.cameras["global"]
        if named is None or camera.mount != "world":
            return {}
        camera_from_world = inverse(camera.world_from_camera)
        across = [float((camera_from_world @ robot.world_from_base)[0, 3]) for robot in self.robots]
        agents = sorted(self.agents, key=lambda agent: across[agent - 1])
        if min(np.diff(sorted(across))) < APART_M:
            return {}
        return dict(zip(named, agents, strict=True))

    @property
    def identity(self) -> dict[str, Any]:
        """What decides its scenes, what is seen of them and when they count as solved.

        Assets by their content, code by its versions. Titles and descriptions decide nothing.
        """
        said = asdict(self)
        objects = {
            name: {**spec, "asset": f"{self.asset(name).name} {self.asset(name).content}"}
            for name, spec in said["objects"].items()
        }
        for spec in objects.values():
            del spec["options"]  # the content tells them
        return {
            **{key: said[key] for key in ("robots", "cameras", "success", "randomisation")},
            "objects": objects,
            "order": list(objects),  # in which they are drawn
            "criteria": self.version,
            "plan": self.plan_version,
        }

    def places(self, scene: Scene) -> Mapping[str, Matrix]:
        """Named places of this task: world_from_object (4, 4) of what is put there."""
        named = getattr(self.module, "places", None)
        return named(scene, self) if named else {}

    def start(self, seed: int) -> "Start":
        """The start of an episode: a pure function of task and seed.

        Objects that would stand in one another are all drawn again. Raises ArgumentError for ranges
        in which there is no room.
        """
        rng = np.random.default_rng([seed, 0])  # stream 0 of the episode: the scene
        for _ in range(_DRAWS):
            poses = self._draw(rng)
            if self._roomy(poses):
                break
        else:
            raise ArgumentError(
                f"task {self.name!r}, seed {seed}: none of {_DRAWS} draws leaves {GAP_M} m between the "
                "objects; widen their ranges"
            )
        rest = np.array([robot.rest_rad for robot in self.robots])
        noise = rng.normal(0.0, self.randomisation.rest_qpos_rad, rest.shape)
        fingers = np.full((len(self.robots), 2), FINGERS_OPEN_M)
        light = 1.0 + rng.uniform(-self.randomisation.light, self.randomisation.light)
        spread = self.randomisation.colour
        tints = {name: 1.0 + rng.uniform(-spread, spread, 3) for name in self.objects}
        masses_kg = {name: self._mass_kg(name, rng.uniform()) for name in self.objects}
        return Start(seed, np.hstack([rest + noise, fingers]), poses, light, tints, masses_kg)

    def _mass_kg(self, name: str, draw: float) -> float:
        asset = self.asset(name)
        heaviest_kg = asset.heavy_kg or asset.mass_kg
        return asset.mass_kg + draw * self.randomisation.heavy * (heaviest_kg - asset.mass_kg)

    def _draw(self, rng: np.random.Generator) -> dict[str, Matrix]:
        poses: dict[str, Matrix] = {}
        for name, spec in self.objects.items():
            local = planar(
                rng.uniform(*spec.x_m),
                rng.uniform(*spec.y_m),
                np.deg2rad(rng.uniform(*spec.yaw_deg)),
                spec.z_m,
            )
            poses[name] = poses[spec.relative_to] @ local if spec.relative_to else local
        return poses

    def _roomy(self, poses: Mapping[str, Matrix]) -> bool:
        """Whether the outlines of objects that share the table are apart. A stack is one outline."""
        outlines = {
            name: MultiPoint(self.asset(name).vertices(pose)[:, :2]).convex_hull
            for name, pose in poses.items()
            if self.asset(name).hulls and not self.objects[name].z_m
        }
        return all(outlines[a].distance(outlines[b]) > GAP_M for a, b in combinations(outlines, 2))


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


class Judge:
    """Judges one episode, step by step: strict conditions must all hold for several steps."""

    def __init__(self, task: Task, start: Scene) -> None:
        self._task, self._start, self._steps = task, start, 0
        self._module, self._bases = task.module, [(robot.x_m, robot.y_m) for robot in task.robots]
        self._let_go_m: dict[str, float] = {}  # object -> its height when it was held last
        places = {name: start.poses[name][:2, 3].tolist() for name in task.objects}
        self._reached = frozenset(name for name, place in places.items() if self._in_reach(*place))

    def __call__(self, scene: Scene) -> Verdict:
        conditions: Mapping[str, Condition] = self._module.conditions(scene, self._start, self._task)
        evidence = {name: bool(holds) for name, holds in conditions.items()}
        self._steps = self._steps + 1 if all(evidence.values()) else 0
        return Verdict(
            self._steps >= int(self._task.success["hold_steps"]),
            bool(self._module.paper(scene, self._start, self._task)),
            evidence,
            {name: found for name, found in conditions.items() if isinstance(found, Measured)},
            self._lost(scene),
        )

    def _lost(self, scene: Scene) -> dict[str, str]:
        """What no arm can get at any more, and what fell out of a hand."""
        lost = {}
        for name in self._task.objects:
            x_m, y_m, height_m = scene.poses[name][:3, 3].tolist()
            if name in scene.held:
                self._let_go_m[name] = height_m
            if height_m < -OFF_M:
                lost[name] = "off the table"
            elif name in self._reached and not self._in_reach(x_m, y_m):
                lost[name] = "out of reach"
            elif self._let_go_m.get(name, height_m) - height_m > DROP_M:
                lost[name] = "dropped"
        return lost

    def _in_reach(self, x_m: float, y_m: float) -> bool:
        return any(hypot(x_m - base_x, y_m - base_y) < REACH_M for base_x, base_y in self._bases)

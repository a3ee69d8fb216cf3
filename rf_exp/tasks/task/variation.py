"""Variation: differences between scenes beyond the starts of objects. Ranges of factors, and draws of a seed.

Every factor has its own stream of random numbers: it draws the same alone as together with others. Bases,
cameras, table height, object sizes and clutter give the scene of a seed its own task (`Task.of`), so that
planner, checks, simulator and criteria all use the actual scene. Only the places of clutter depend on other
factors. Postures, sensors and actuators belong to the start of an episode (`Start`). Factors and ranges are
those of RoboTwin 2.0 (arXiv 2506.18088), THE COLOSSEUM (arXiv 2402.08191) and LIBERO-Plus (arXiv 2510.13626),
and some for several arms.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from rf_exp.artifacts import plain, without
from rf_exp.errors import ArgumentError, choices
from rf_exp.tasks.task.clutter import Clutter, drawn_piece, placed
from rf_exp.tasks.task.specs import LARGEST, SMALLEST, CameraMotion
from rf_exp.transforms import rotated
from rf_exp.types import (
    CONTROL_DT_S,
    MOST_LAMPS,
    UNVARIED,
    VARIATION,
    Finish,
    Lamp,
    Light,
    Look,
    Scene,
    Texture,
    TextureKind,
    TextureSet,
)

if TYPE_CHECKING:
    from rf_exp.tasks.task.task import Task

FACTORS = ("table", "bases", "posture", "cameras", "sensors", "actuators", "appearance", "light")
FACTORS += ("instances", "clutter", "one_arm")
SHOWN = ("cameras", "sensors", "appearance", "light")  # visual factors: they change pictures only
MOVES = ("table", "bases", "cameras", "instances")  # factors that `moved` applies
Textures = Literal["plain", "seen", "unseen"]  # unchanged, or from one of two sets
Known = Literal["known", "unknown"]
TILES_M = 0.6, 1.0, 1.0  # sides of a texture's tile on table, floor and walls
TEXTURED = 0.75  # fraction of varied surfaces with a texture
FURTHER = 0.6, 0.6, 0.6  # irradiance of a lamp beyond the usual ones
MOST_CLUTTER = 10
FINGER_ROOM_M = 0.006  # clearance of an open finger from the object it closes on
HAND_ROOM_M = 0.008  # clearance between an object and a gripper at rest above it
TIP_M = 0.011  # length of the fingertips beyond the TCP


def key(factor: str, default: Any, **bounds: tuple[float, float]) -> Any:
    """Dataclass field for a key of a factor; its value, or both ends of a range, must lie `within` bounds."""
    return field(default=default, metadata={"factor": factor, **bounds})


def bounded(factor: str, most: float) -> Any:
    """Dataclass field for a number from 0, the default, to `most`."""
    return key(factor, 0.0, within=(0, most))


@dataclass(frozen=True)
class Variation:
    """Ranges of the factors. A single number is the half range of a uniform draw about the task's value.

    Raises ArgumentError for a range out of bounds.
    """

    name: str = UNVARIED  # of the choice, as in rows and file names
    textures: Textures = field(default="plain", metadata={"factor": "appearance"})  # table, floor, walls
    object_colour: float = bounded("appearance", 1)  # relative brightness per channel of an object
    lamps: tuple[int, int] = key("light", (2, 2), within=(0, MOST_LAMPS))  # number of lamps
    light_intensity: float = bounded("light", 3)  # log2 of the relative brightness of all lights
    light_colour: tuple[float, float] = key("light", (1.0, 1.0), within=(0.0, 4.0))  # gain per channel
    light_direction_deg: float = bounded("light", 90)  # largest rotation of a lamp
    table_height_m: tuple[float, float] = key("table", (0.0, 0.0), within=(-0.1, 0.1))  # above bases
    base_position_m: float = bounded("bases", 0.2)  # of each base, along x and y
    base_yaw_deg: float = bounded("bases", 45)
    posture_rad: float = bounded("posture", 0.5)  # of each joint at the start, beside `init_qpos_std_rad`
    camera_position_m: float = bounded("cameras", 0.5)  # along each axis
    camera_direction_deg: tuple[float, float] = key("cameras", (0.0, 0.0), within=(0.0, 45.0))  # random axis
    camera_fov_deg: float = bounded("cameras", 20)
    calibration: Known = "known"  # unknown: policies get the nominal poses of arms and cameras
    exposure: float = bounded("sensors", 2)  # log2 of the relative exposure of cameras
    flicker: float = bounded("sensors", 1)  # fraction of frames with a changed exposure
    pixel_noise: float = bounded("sensors", 100)  # standard deviation, of 255
    delay_s: tuple[float, float] = key("actuators", (0.0, 0.0), within=(0.0, 1.0))  # latency
    joint_offset_deg: float = bounded("actuators", 10)  # error of each measured joint
    object_size: tuple[float, float] = key("instances", (1.0, 1.0), within=(SMALLEST, LARGEST))  # scale
    clutter: tuple[int, int] = key("clutter", (0, 0), within=(0, MOST_CLUTTER))  # number of pieces
    clutter_set: TextureSet = field(default="seen", metadata={"factor": "clutter"})  # shapes, colours
    clutter_area_m: tuple[float, float] = key("clutter", (0.6, 0.8))  # half extents x, y, about the starts
    arm_delay_s: float = bounded("one_arm", 5.0)  # latency of the commands of one random arm
    arm_speed_rad_s: float = bounded("one_arm", 10.0)  # joint speed limit of that arm; 0: none
    camera_dark: bool = key("one_arm", False)  # whether the camera of that arm is black

    def __post_init__(self) -> None:
        for each in fields(self):
            if "within" not in each.metadata:
                continue
            value, (least, most) = getattr(self, each.name), each.metadata["within"]
            if not isinstance(value, tuple):
                if not least <= value <= most:
                    raise ArgumentError(f"variation.{each.name} is {value}; expected {least} to {most}")
            elif not least <= value[0] <= value[1] <= most:
                raise ArgumentError(
                    f"variation.{each.name} is {[*value]}; expected [LOW, HIGH] within [{least}, {most}]"
                )
        for name, possible in (("textures", Textures), ("clutter_set", TextureSet), ("calibration", Known)):
            if (value := getattr(self, name)) not in get_args(possible):
                raise choices(f"variation.{name}", value, get_args(possible))
        if not all(0 < half_m <= 2 for half_m in self.clutter_area_m):
            raise ArgumentError(
                f"variation.clutter_area_m is {[*self.clutter_area_m]}; expected two numbers, 0 < m <= 2"
            )

    @property
    def factors(self) -> tuple[str, ...]:
        """Factors that vary."""
        return tuple(factor for factor in FACTORS if {*self.identity} & {*keys_of(factor)})

    @cached_property
    def identity(self) -> dict[str, Any]:
        """Keys that differ from their defaults, which determine scenes; empty where nothing varies."""
        return {
            each.name: value
            for each in fields(self)
            if each.name != "name" and (value := getattr(self, each.name)) != each.default
        }

    @property
    def held_out(self) -> "Variation":
        """The variation for evaluation: with textures and clutter that demonstrations do not show."""
        found = replace(self, textures="unseen") if self.textures == "seen" else self
        return replace(found, clutter_set="unseen") if self.clutter[1] else found

    @property
    def seen(self) -> bool:
        """Whether a visual factor varies."""
        return bool({*self.factors} & {*SHOWN})


def keys_of(*factors: str) -> tuple[str, ...]:
    """Keys of these factors."""
    return tuple(each.name for each in fields(Variation) if each.metadata.get("factor") in factors)


NONE = Variation()
PHYSICAL = keys_of(*(factor for factor in FACTORS if factor not in SHOWN))  # keys of all other factors
MOVING = keys_of(*MOVES)


@dataclass(frozen=True)
class Impaired:
    """Impairment of one agent."""

    agent: int
    delay_steps: int  # latency of its commands, control steps
    speed_rad_s: float  # limit of its joint speeds; 0: none
    dark: bool  # whether its camera is black


@dataclass(frozen=True)
class Devices:
    """Errors of sensors and actuators in one episode."""

    gain: float = 1.0  # relative exposure
    flicker: float = 0.0  # fraction of frames with a further change of exposure
    pixel_noise: float = 0.0  # standard deviation, of 255
    delay_steps: int = 0  # latency of commands, control steps
    joint_offset_rad: tuple[tuple[float, ...], ...] = ()  # (N, dof) measured minus true; empty: none
    impaired: Impaired | None = None

    @property
    def exact(self) -> bool:
        """Whether there are no errors."""
        return self == EXACT

    @property
    def sees_exactly(self) -> bool:
        """Whether pictures stay as rendered."""
        dark = self.impaired is not None and self.impaired.dark
        return self.gain == 1 and not self.flicker and not self.pixel_noise and not dark


EXACT = Devices()


@dataclass(frozen=True)
class Drawn:
    """All draws of a seed for a variation."""

    table_height_m: float
    bases: tuple[tuple[float, float, float], ...]  # x (m), y (m), yaw (deg) of each arm
    posture_rad: NDArray[np.float64]  # (N, dof) added to the joints at the start
    cameras: Mapping[str, CameraMotion]
    devices: Devices
    tints: Mapping[str, tuple[float, ...]]  # object -> (3,) relative brightness of red, green, blue
    look: Look
    light: Light
    sizes: Mapping[str, float]  # object -> scale
    clutter: tuple[Clutter, ...]  # not yet placed

    def plain(self) -> dict[str, Any]:
        """JSON values, without clutter, sizes and impairment where these do not vary."""
        found = without(plain(asdict(self)), clutter=[], sizes=dict.fromkeys(self.sizes, 1.0))
        return {**found, "devices": without(found["devices"], impaired=None)}


def draw(task: "Task", seed: int, copy: int = 0) -> Drawn:
    """All draws of a seed: a pure function of task, seed and `copy`, which changes visual factors only."""
    how = task.variation
    rng = {
        name: np.random.default_rng([seed, VARIATION, k, *([copy] if copy and name in SHOWN else [])])
        for k, name in enumerate(FACTORS)
    }
    about = how.base_position_m, how.base_position_m, how.base_yaw_deg
    bases = [rng["bases"].uniform(-1, 1, 3) * about for _ in task.robots]
    posture = rng["posture"].uniform(-1, 1, (len(task.robots), task.dof)) * how.posture_rad
    sensors, actuators = rng["sensors"], rng["actuators"]
    gain = 2.0 ** (how.exposure * sensors.uniform(-1, 1))
    delay_steps = round(actuators.uniform(*how.delay_s) / CONTROL_DT_S)
    offset = np.deg2rad(how.joint_offset_deg) * actuators.uniform(-1, 1, (len(task.robots), task.dof))
    offsets = tuple(map(tuple, offset.tolist())) if how.joint_offset_deg else ()
    pieces = int(rng["clutter"].integers(how.clutter[0], how.clutter[1] + 1)) if how.clutter[1] else 0
    table_m = float(rng["table"].uniform(*how.table_height_m))
    return Drawn(
        table_m,
        tuple((float(x), float(y), float(yaw)) for x, y, yaw in bases),
        posture,
        {name: _camera(how, rng["cameras"], table_m) for name in task.cameras},
        Devices(
            float(gain), how.flicker, how.pixel_noise, delay_steps, offsets, _impaired(task, rng["one_arm"])
        ),
        *_appearance(task, rng["appearance"]),
        _light(how, rng["light"]),
        sizes_of(task, how.object_size, rng["instances"]),
        tuple(drawn_piece(how.clutter_set, rng["clutter"]) for _ in range(pieces)),
    )


def _appearance(task: "Task", rng: np.random.Generator) -> tuple[Mapping[str, tuple[float, ...]], Look]:
    """Tints of objects, and finishes of table, floor and walls."""
    how = task.variation
    tints = {name: tuple((1.0 + how.object_colour * rng.uniform(-1, 1, 3)).tolist()) for name in task.objects}
    if how.textures == "plain":
        return tints, Look()
    return tints, Look(*(_finish(how.textures, tile_m, rng) for tile_m in TILES_M))


def _finish(of: TextureSet, tile_m: float, rng: np.random.Generator) -> Finish:
    """A texture with probability TEXTURED, else a plain colour."""
    kind: TextureKind = rng.choice(get_args(TextureKind)).item()
    texture = Texture(kind, of, int(rng.integers(2**31)), tile_m * float(rng.uniform(0.7, 1.4)))
    red, green, blue = rng.uniform(0.05, 0.8, 3).tolist()
    roughness = float(rng.uniform(0.4, 1.0))
    if rng.uniform() < TEXTURED:
        return Finish(texture=texture, roughness=roughness)
    return Finish((red, green, blue), roughness=roughness)


def sizes_of(task: "Task", between: tuple[float, float], rng: np.random.Generator) -> dict[str, float]:
    """Object -> its scale, drawn uniformly from the range `between`.

    An object that stands on another has the scale of that one; a mark on the table has scale 1. Scales above
    1 are limited so that grippers open wide enough and, at rest, do not touch the object.
    """
    drawn = {name: float(rng.uniform(*between)) for name in task.objects}
    if between == (1.0, 1.0):
        return drawn
    bearer: dict[str, str] = {}
    for name, spec in task.objects.items():
        bearer[name] = name if spec.stands_on is None else bearer[spec.stands_on]
    largest = {
        one: max(1.0, min(_largest(task, name) for name in task.objects if bearer[name] == one))
        for one in bearer.values()
    }
    return {
        name: min(drawn[one], largest[one]) if task.asset(name).hulls else 1.0 for name, one in bearer.items()
    }


def _largest(task: "Task", name: str) -> float:
    """The largest scale of an object for which grippers open wide enough and rest clear of it."""
    asset, spec = task.asset(name), task.objects[name]
    if not asset.hulls:
        return np.inf
    open_m = 2 * min(robot.model.hand.open_m - FINGER_ROOM_M for robot in task.robots)
    widths_m = [point.width_m for point in asset.points.values() if point.kind == "grasp"]
    found = [open_m / width_m for width_m in widths_m]
    top_m = spec.z_m + float(asset.bounds_m[1, 2])
    across_m = float(np.linalg.norm(asset.bounds_m[:, :2], axis=1).max())
    first = spec
    while first.relative_to is not None:
        first = task.objects[first.relative_to]
    for robot, arm in zip(task.robots, task.arms.values(), strict=True):
        x_m, y_m, z_m = arm.tcp(robot.at_rest)[:3, 3].tolist()
        beside = (max(low - at, at - high) for at, (low, high) in ((x_m, first.x_m), (y_m, first.y_m)))
        if max(beside) < across_m:
            found.append((z_m - TIP_M - HAND_ROOM_M) / top_m)
    return min(found, default=np.inf)


def _impaired(task: "Task", rng: np.random.Generator) -> Impaired | None:
    how, agent = task.variation, int(rng.choice(task.agents))
    if not (how.arm_delay_s or how.arm_speed_rad_s or how.camera_dark):
        return None
    return Impaired(agent, round(how.arm_delay_s / CONTROL_DT_S), how.arm_speed_rad_s, how.camera_dark)


def _light(how: Variation, rng: np.random.Generator) -> Light:
    """The usual lamps first, in changed directions and colours; further ones shine from above."""
    bright = 2.0 ** (how.light_intensity * rng.uniform(-1, 1))
    count = int(rng.integers(how.lamps[0], how.lamps[1] + 1))
    usual, lamps = Light(), []
    for number in range(MOST_LAMPS):  # draws for all, so that their number changes no other draw
        axis, angle, colour = rng.normal(size=3), rng.uniform(), rng.uniform(*how.light_colour, 3)
        above = *rng.uniform(-1, 1, 2), -1.0
        lamp = usual.lamps[number] if number < len(usual.lamps) else Lamp(above, FURTHER)
        turn = rotated(np.deg2rad(how.light_direction_deg) * angle * axis / np.linalg.norm(axis))
        x, y, z = (turn[:3, :3] @ lamp.direction).tolist()
        red, green, blue = (bright * colour * lamp.colour).tolist()
        lamps.append(Lamp((x, y, z), (red, green, blue)))
    red, green, blue = (bright * rng.uniform(*how.light_colour, 3) * usual.ambient).tolist()
    return Light((red, green, blue), tuple(lamps[:count]))


def _camera(how: Variation, rng: np.random.Generator, table_m: float) -> CameraMotion:
    """The motion of one camera. Draws for all keys, so that one alone acts as it does beside others."""
    shift, axis, angle, fov = rng.uniform(-1, 1, 3), rng.normal(size=3), rng.uniform(), rng.uniform(-1, 1)
    least_deg, most_deg = how.camera_direction_deg
    turn = (least_deg + (most_deg - least_deg) * angle) * axis / np.linalg.norm(axis)
    x, y, z = (how.camera_position_m * shift).tolist()
    return CameraMotion((x, y, z - table_m), tuple(turn.tolist()), float(how.camera_fov_deg * fov))


def moved(task: "Task", seed: int, copy: int) -> "Task":
    """The task of a scene: bases, cameras, object sizes and table height as the seed draws them.

    The table stays at z = 0: a higher table lowers arms and cameras instead.
    """
    if not {*task.variation.factors} & {*MOVES}:
        return task
    drawn = draw(task, seed, copy)
    up_m = drawn.table_height_m
    robots = tuple(
        replace(
            robot, x_m=robot.x_m + x, y_m=robot.y_m + y, yaw_deg=robot.yaw_deg + yaw, z_m=robot.z_m - up_m
        )
        for robot, (x, y, yaw) in zip(task.robots, drawn.bases, strict=True)
    )
    cameras = {name: spec.moved(drawn.cameras[name]) for name, spec in task.cameras.items()}
    objects = {name: spec.sized(drawn.sizes[name]) for name, spec in task.objects.items()}
    variation = replace(task.variation, **{name: getattr(NONE, name) for name in MOVING})
    return replace(task, robots=robots, cameras=cameras, objects=objects, variation=variation)


def cluttered(task: "Task", scene: Scene, seed: int) -> "Task":
    """The task of a scene with its clutter; `scene` is its start."""
    pieces, stream = draw(task, seed).clutter, [seed, VARIATION, FACTORS.index("clutter")]
    found = placed(task, task.places(scene), pieces, stream)
    return replace(task, clutter=found, variation=replace(task.variation, clutter=NONE.clutter))


def drawn_of(task: "Task", seed: int, copy: int = 0) -> dict[str, Any]:
    """Draws of a seed as JSON values; empty where nothing varies.

    Clutter: the placed pieces, and the number of pieces that found no place.
    """
    if not task.variation.identity:
        return {}
    drawn = draw(task, seed, copy)
    found = drawn.plain()
    if drawn.clutter:
        there = task.of(seed).clutter
        found["clutter"] = {name: asdict(piece) for name, piece in there.items()}
        found["clutter_left_out"] = len(drawn.clutter) - len(there)
    return found


def scene_certificate(task: "Task", seed: int, copy: int = 0) -> dict[str, Any]:
    """Certificate of an episode's scene: draws, poses of arms and cameras; empty where nothing varies."""
    if not task.variation.identity:
        return {}
    stands = task.of(seed, copy)
    cameras = {
        name: {"parent_from_camera": stands.parent_from_camera(name).tolist(), "fov_deg": spec.fov_deg}
        for name, spec in stands.cameras.items()
    }
    calibration = {"world_from_base": [robot.world_from_base.tolist() for robot in stands.robots]}
    return {"drawn": drawn_of(task, seed, copy), "calibration": {**calibration, "cameras": cameras}}

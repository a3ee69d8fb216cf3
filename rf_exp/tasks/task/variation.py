"""Variation: differences between scenes beyond the starts of objects. Ranges of factors, and draws of a seed.

Every factor has its own stream of random numbers: it draws the same alone as together with others. Bases,
cameras, table height, object sizes and clutter give the scene of a seed its own task (`Task.in_scene`), so
that planner, checks, simulator and criteria all use the actual scene. Only the places of clutter depend on
other factors. Postures, sensors and actuators belong to the start of an episode (`Start`). Factors and ranges
are those of RoboTwin 2.0 (arXiv 2506.18088), THE COLOSSEUM (arXiv 2402.08191) and LIBERO-Plus (arXiv
2510.13626), and some for several arms.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from rf_exp.artifacts import drop_defaults, plain
from rf_exp.errors import ArgumentError, unknown_choice
from rf_exp.tasks.task.clutter import Clutter, place_pieces, random_piece
from rf_exp.tasks.task.specs import LARGEST, SMALLEST, CameraMotion
from rf_exp.transforms import rotation_matrix
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
VISUAL_FACTORS = ("cameras", "sensors", "appearance", "light")  # factors that change pictures only
SCENE_FACTORS = ("table", "bases", "cameras", "instances")  # factors that `with_scene_factors` applies
Textures = Literal["plain", "seen", "unseen"]  # unchanged, or from one of two sets
Known = Literal["known", "unknown"]
TILE_SIZES_M = 0.6, 1.0, 1.0  # sides of a texture's tile on table, floor and walls
TEXTURE_PROBABILITY = 0.75  # fraction of varied surfaces with a texture
EXTRA_LAMP_IRRADIANCE = 0.6, 0.6, 0.6  # of a lamp beyond the usual ones
MOST_CLUTTER = 10
FINGER_CLEARANCE_M = 0.006  # clearance of an open finger from the object it closes on
GRIPPER_CLEARANCE_M = 0.008  # clearance between an object and a gripper at rest above it
FINGERTIP_M = 0.011  # length of the fingertips beyond the TCP


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
        for item in fields(self):
            if "within" not in item.metadata:
                continue
            value, (least, most) = getattr(self, item.name), item.metadata["within"]
            if not isinstance(value, tuple):
                if not least <= value <= most:
                    raise ArgumentError(f"variation.{item.name} is {value}; expected {least} to {most}")
            elif not least <= value[0] <= value[1] <= most:
                raise ArgumentError(
                    f"variation.{item.name} is {[*value]}; expected [LOW, HIGH] within [{least}, {most}]"
                )
        for name, possible in (("textures", Textures), ("clutter_set", TextureSet), ("calibration", Known)):
            if (value := getattr(self, name)) not in get_args(possible):
                raise unknown_choice(f"variation.{name}", value, get_args(possible))
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
            item.name: value
            for item in fields(self)
            if item.name != "name" and (value := getattr(self, item.name)) != item.default
        }

    @property
    def held_out(self) -> "Variation":
        """The variation for evaluation: with textures and clutter that demonstrations do not show."""
        variation = replace(self, textures="unseen") if self.textures == "seen" else self
        return replace(variation, clutter_set="unseen") if self.clutter[1] else variation

    @property
    def varies_visually(self) -> bool:
        """Whether a visual factor varies."""
        return bool({*self.factors} & {*VISUAL_FACTORS})


def keys_of(*factors: str) -> tuple[str, ...]:
    """Keys of these factors."""
    return tuple(item.name for item in fields(Variation) if item.metadata.get("factor") in factors)


NO_VARIATION = Variation()
# keys of all other factors
PHYSICAL_KEYS = keys_of(*(factor for factor in FACTORS if factor not in VISUAL_FACTORS))
SCENE_KEYS = keys_of(*SCENE_FACTORS)


@dataclass(frozen=True)
class Impairment:
    """Impairment of one agent."""

    agent: int
    delay_steps: int  # latency of its commands, control steps
    speed_rad_s: float  # limit of its joint speeds; 0: none
    dark: bool  # whether its camera is black


@dataclass(frozen=True)
class DeviceErrors:
    """Errors of sensors and actuators in one episode."""

    gain: float = 1.0  # relative exposure
    flicker: float = 0.0  # fraction of frames with a further change of exposure
    pixel_noise: float = 0.0  # standard deviation, of 255
    delay_steps: int = 0  # latency of commands, control steps
    joint_offset_rad: tuple[tuple[float, ...], ...] = ()  # (N, dof) measured minus true; empty: none
    impaired: Impairment | None = None

    @property
    def exact(self) -> bool:
        """Whether there are no errors."""
        return self == NO_DEVICE_ERRORS

    @property
    def exact_pictures(self) -> bool:
        """Whether pictures stay as rendered."""
        dark = self.impaired is not None and self.impaired.dark
        return self.gain == 1 and not self.flicker and not self.pixel_noise and not dark


NO_DEVICE_ERRORS = DeviceErrors()


@dataclass(frozen=True)
class Drawn:
    """All draws of a seed for a variation."""

    table_height_m: float
    bases: tuple[tuple[float, float, float], ...]  # x (m), y (m), yaw (deg) of each arm
    posture_rad: NDArray[np.float64]  # (N, dof) added to the joints at the start
    cameras: Mapping[str, CameraMotion]
    devices: DeviceErrors
    tints: Mapping[str, tuple[float, ...]]  # object -> (3,) relative brightness of red, green, blue
    look: Look
    light: Light
    sizes: Mapping[str, float]  # object -> scale
    clutter: tuple[Clutter, ...]  # not yet placed

    def plain(self) -> dict[str, Any]:
        """JSON values, without clutter, sizes and impairment where these do not vary."""
        values = drop_defaults(plain(asdict(self)), clutter=[], sizes=dict.fromkeys(self.sizes, 1.0))
        return {**values, "devices": drop_defaults(values["devices"], impaired=None)}


def draw(task: "Task", seed: int, copy: int = 0) -> Drawn:
    """All draws of a seed: a pure function of task, seed and `copy`, which changes visual factors only."""
    variation = task.variation
    rng = {
        name: np.random.default_rng(
            [seed, VARIATION, k, *([copy] if copy and name in VISUAL_FACTORS else [])]
        )
        for k, name in enumerate(FACTORS)
    }
    half_ranges = variation.base_position_m, variation.base_position_m, variation.base_yaw_deg
    bases = [rng["bases"].uniform(-1, 1, 3) * half_ranges for _ in task.robots]
    posture = rng["posture"].uniform(-1, 1, (len(task.robots), task.dof)) * variation.posture_rad
    sensors, actuators = rng["sensors"], rng["actuators"]
    gain = 2.0 ** (variation.exposure * sensors.uniform(-1, 1))
    delay_steps = round(actuators.uniform(*variation.delay_s) / CONTROL_DT_S)
    offset = np.deg2rad(variation.joint_offset_deg) * actuators.uniform(-1, 1, (len(task.robots), task.dof))
    offsets = tuple(map(tuple, offset.tolist())) if variation.joint_offset_deg else ()
    pieces = (
        int(rng["clutter"].integers(variation.clutter[0], variation.clutter[1] + 1))
        if variation.clutter[1]
        else 0
    )
    table_m = float(rng["table"].uniform(*variation.table_height_m))
    return Drawn(
        table_m,
        tuple((float(x), float(y), float(yaw)) for x, y, yaw in bases),
        posture,
        {name: _draw_camera_motion(variation, rng["cameras"], table_m) for name in task.cameras},
        DeviceErrors(
            float(gain),
            variation.flicker,
            variation.pixel_noise,
            delay_steps,
            offsets,
            _draw_impairment(task, rng["one_arm"]),
        ),
        *_draw_appearance(task, rng["appearance"]),
        _draw_light(variation, rng["light"]),
        draw_sizes(task, variation.object_size, rng["instances"]),
        tuple(random_piece(variation.clutter_set, rng["clutter"]) for _ in range(pieces)),
    )


def _draw_appearance(task: "Task", rng: np.random.Generator) -> tuple[Mapping[str, tuple[float, ...]], Look]:
    """Tints of objects, and finishes of table, floor and walls."""
    variation = task.variation
    tints = {
        name: tuple((1.0 + variation.object_colour * rng.uniform(-1, 1, 3)).tolist()) for name in task.objects
    }
    if variation.textures == "plain":
        return tints, Look()
    return tints, Look(*(_draw_finish(variation.textures, tile_m, rng) for tile_m in TILE_SIZES_M))


def _draw_finish(texture_set: TextureSet, tile_m: float, rng: np.random.Generator) -> Finish:
    """A texture with probability TEXTURE_PROBABILITY, else a plain colour."""
    kind: TextureKind = rng.choice(get_args(TextureKind)).item()
    texture = Texture(kind, texture_set, int(rng.integers(2**31)), tile_m * float(rng.uniform(0.7, 1.4)))
    red, green, blue = rng.uniform(0.05, 0.8, 3).tolist()
    roughness = float(rng.uniform(0.4, 1.0))
    if rng.uniform() < TEXTURE_PROBABILITY:
        return Finish(texture=texture, roughness=roughness)
    return Finish((red, green, blue), roughness=roughness)


def draw_sizes(task: "Task", scale_range: tuple[float, float], rng: np.random.Generator) -> dict[str, float]:
    """Object -> its scale, drawn uniformly from `scale_range`.

    An object that stands on another has the scale of that one; a mark on the table has scale 1. Scales above
    1 are limited so that grippers open wide enough and, at rest, do not touch the object.
    """
    drawn = {name: float(rng.uniform(*scale_range)) for name in task.objects}
    if scale_range == (1.0, 1.0):
        return drawn
    bearer: dict[str, str] = {}
    for name, spec in task.objects.items():
        bearer[name] = name if spec.stands_on is None else bearer[spec.stands_on]
    largest = {
        base: max(1.0, min(_largest_size(task, name) for name in task.objects if bearer[name] == base))
        for base in bearer.values()
    }
    return {
        name: min(drawn[base], largest[base]) if task.asset(name).hulls else 1.0
        for name, base in bearer.items()
    }


def _largest_size(task: "Task", name: str) -> float:
    """The largest scale of an object for which grippers open wide enough and rest clear of it."""
    asset, spec = task.asset(name), task.objects[name]
    if not asset.hulls:
        return np.inf
    open_m = 2 * min(robot.model.hand.open_m - FINGER_CLEARANCE_M for robot in task.robots)
    widths_m = [point.width_m for point in asset.points.values() if point.kind == "grasp"]
    limits = [open_m / width_m for width_m in widths_m]
    top_m = spec.z_m + float(asset.bounds_m[1, 2])
    across_m = float(np.linalg.norm(asset.bounds_m[:, :2], axis=1).max())
    support = spec
    while support.relative_to is not None:
        support = task.objects[support.relative_to]
    for robot, arm in zip(task.robots, task.arms.values(), strict=True):
        x_m, y_m, z_m = arm.tcp(robot.rest_qpos)[:3, 3].tolist()
        beside = (max(low - at, at - high) for at, (low, high) in ((x_m, support.x_m), (y_m, support.y_m)))
        if max(beside) < across_m:
            limits.append((z_m - FINGERTIP_M - GRIPPER_CLEARANCE_M) / top_m)
    return min(limits, default=np.inf)


def _draw_impairment(task: "Task", rng: np.random.Generator) -> Impairment | None:
    variation, agent = task.variation, int(rng.choice(task.agents))
    if not (variation.arm_delay_s or variation.arm_speed_rad_s or variation.camera_dark):
        return None
    return Impairment(
        agent, round(variation.arm_delay_s / CONTROL_DT_S), variation.arm_speed_rad_s, variation.camera_dark
    )


def _draw_light(variation: Variation, rng: np.random.Generator) -> Light:
    """The usual lamps first, in changed directions and colours; further ones shine from above."""
    bright = 2.0 ** (variation.light_intensity * rng.uniform(-1, 1))
    count = int(rng.integers(variation.lamps[0], variation.lamps[1] + 1))
    usual, lamps = Light(), []
    for number in range(MOST_LAMPS):  # draws for all, so that their number changes no other draw
        axis, angle, colour = rng.normal(size=3), rng.uniform(), rng.uniform(*variation.light_colour, 3)
        above = *rng.uniform(-1, 1, 2), -1.0
        lamp = usual.lamps[number] if number < len(usual.lamps) else Lamp(above, EXTRA_LAMP_IRRADIANCE)
        turn = rotation_matrix(
            np.deg2rad(variation.light_direction_deg) * angle * axis / np.linalg.norm(axis)
        )
        x, y, z = (turn[:3, :3] @ lamp.direction).tolist()
        red, green, blue = (bright * colour * lamp.colour).tolist()
        lamps.append(Lamp((x, y, z), (red, green, blue)))
    red, green, blue = (bright * rng.uniform(*variation.light_colour, 3) * usual.ambient).tolist()
    return Light((red, green, blue), tuple(lamps[:count]))


def _draw_camera_motion(variation: Variation, rng: np.random.Generator, table_m: float) -> CameraMotion:
    """The motion of one camera. Draws for all keys, so that one alone acts as it does beside others."""
    shift, axis, angle, fov = rng.uniform(-1, 1, 3), rng.normal(size=3), rng.uniform(), rng.uniform(-1, 1)
    least_deg, most_deg = variation.camera_direction_deg
    turn = (least_deg + (most_deg - least_deg) * angle) * axis / np.linalg.norm(axis)
    x, y, z = (variation.camera_position_m * shift).tolist()
    return CameraMotion((x, y, z - table_m), tuple(turn.tolist()), float(variation.camera_fov_deg * fov))


def with_scene_factors(task: "Task", seed: int, copy: int) -> "Task":
    """The task of a scene: bases, cameras, object sizes and table height as the seed draws them.

    The table stays at z = 0: a higher table lowers arms and cameras instead.
    """
    if not {*task.variation.factors} & {*SCENE_FACTORS}:
        return task
    drawn = draw(task, seed, copy)
    table_height_m = drawn.table_height_m
    robots = tuple(
        replace(
            robot,
            x_m=robot.x_m + x,
            y_m=robot.y_m + y,
            yaw_deg=robot.yaw_deg + yaw,
            z_m=robot.z_m - table_height_m,
        )
        for robot, (x, y, yaw) in zip(task.robots, drawn.bases, strict=True)
    )
    cameras = {name: spec.moved(drawn.cameras[name]) for name, spec in task.cameras.items()}
    objects = {name: spec.scaled(drawn.sizes[name]) for name, spec in task.objects.items()}
    variation = replace(task.variation, **{name: getattr(NO_VARIATION, name) for name in SCENE_KEYS})
    return replace(task, robots=robots, cameras=cameras, objects=objects, variation=variation)


def with_clutter(task: "Task", scene: Scene, seed: int) -> "Task":
    """The task of a scene with its clutter; `scene` is its start."""
    pieces, stream = draw(task, seed).clutter, [seed, VARIATION, FACTORS.index("clutter")]
    placed = place_pieces(task, task.places(scene), pieces, stream)
    return replace(task, clutter=placed, variation=replace(task.variation, clutter=NO_VARIATION.clutter))


def scene_draws(task: "Task", seed: int, copy: int = 0) -> dict[str, Any]:
    """Draws of a seed as JSON values; empty where nothing varies.

    Clutter: the placed pieces, and the number of pieces that found no place.
    """
    if not task.variation.identity:
        return {}
    drawn = draw(task, seed, copy)
    values = drawn.plain()
    if drawn.clutter:
        placed = task.in_scene(seed).clutter
        values["clutter"] = {name: asdict(piece) for name, piece in placed.items()}
        values["clutter_left_out"] = len(drawn.clutter) - len(placed)
    return values


def scene_certificate(task: "Task", seed: int, copy: int = 0) -> dict[str, Any]:
    """Certificate of an episode's scene: draws, poses of arms and cameras; empty where nothing varies."""
    if not task.variation.identity:
        return {}
    scene_task = task.in_scene(seed, copy)
    cameras = {
        name: {"parent_from_camera": scene_task.parent_from_camera(name).tolist(), "fov_deg": spec.fov_deg}
        for name, spec in scene_task.cameras.items()
    }
    calibration = {"world_from_base": [robot.world_from_base.tolist() for robot in scene_task.robots]}
    return {"drawn": scene_draws(task, seed, copy), "calibration": {**calibration, "cameras": cameras}}

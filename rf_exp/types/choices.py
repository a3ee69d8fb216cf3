"""Choices of an experiment: constraints, architecture, cameras, and the appearance of the scene."""

import math
from dataclasses import dataclass, replace
from typing import Literal, get_args

from rf_exp.errors import ArgumentError, unknown_choice

MIN_DISPLAY_PX = 240  # smallest height of pictures for people; policies need less
SMALLEST_PX, LARGEST_PX = 16, 2048  # of a picture's side: episodes with the largest ones take gigabytes
UNVARIED = "none"  # scenes differ by start poses of objects, and a little in light and colour
Kind = Literal["logical", "temporal", "spatial"]
CameraChoice = Literal["all", "global", "local"]
Occupancy = Literal["state", "depth"]  # source of the scene for spatial constraints: poses, or cameras


@dataclass(frozen=True)
class ConstraintSet:
    """A row of the paper's ablation: the kinds of constraints that are on (logical ones always are).

    By default all of them: the library has no configuration.
    """

    name: str
    logical: bool = True
    spatial: bool = True
    temporal: bool = True

    @property
    def off(self) -> tuple[Kind, ...]:
        """The kinds of constraints that are not checked."""
        return tuple(kind for kind in get_args(Kind) if not getattr(self, kind))


@dataclass(frozen=True)
class Arch:
    """One of the paper's four imitation learning architectures (section 4.2), or the coordinated one."""

    name: str
    shared_policy: bool
    global_view: bool
    coordinated: bool = False  # RoboBrain and RoboChecker give each agent's subgoal and whether it waits
    both_views: bool = False  # a separate policy with the own and the global camera


FOREIGN = Arch("foreign", shared_policy=True, global_view=True)  # of policies not trained by this suite


@dataclass(frozen=True)
class Pictures:
    """Pictures of the cameras: size in pixels, or none at all.

    Raises ArgumentError for a size out of bounds or an unknown choice of cameras.
    """

    width: int
    height: int
    render: bool
    cameras: CameraChoice  # recorded in demonstrations; local: the cameras of the agents

    def __post_init__(self) -> None:
        if self.cameras not in get_args(CameraChoice):
            raise unknown_choice("cameras", self.cameras, get_args(CameraChoice))
        for name, side in (("width", self.width), ("height", self.height)):
            if not SMALLEST_PX <= side <= LARGEST_PX:
                possible = f"{SMALLEST_PX} to {LARGEST_PX} pixels"
                raise ArgumentError(f"picture.{name} is {side}; possible are {possible}")

    @property
    def enlarged(self) -> "Pictures":
        """The same, enlarged for people: at least `MIN_DISPLAY_PX` high."""
        if self.height >= MIN_DISPLAY_PX:
            return self
        return replace(
            self, width=min(LARGEST_PX, self.width * MIN_DISPLAY_PX // self.height), height=MIN_DISPLAY_PX
        )

    def camera_names(self, agents: int) -> tuple[str, ...]:
        """The names of the cameras for a number of agents; empty without rendering."""
        return camera_names(self.cameras, agents) if self.render else ()


NO_PICTURES = Pictures(SMALLEST_PX, SMALLEST_PX, render=False, cameras="all")  # the size is unused


def camera_names(chosen: CameraChoice, agents: int) -> tuple[str, ...]:
    """The names of the chosen cameras for a number of agents."""
    local = tuple(f"agent{k}" for k in range(1, agents + 1))
    return {"all": ("global", *local), "global": ("global",), "local": local}[chosen]


@dataclass(frozen=True)
class Extras:
    """Camera data that demonstrations hold besides pictures."""

    depth: bool
    segmentation: bool


NO_EXTRAS = Extras(depth=False, segmentation=False)


@dataclass(frozen=True)
class JointLimits:
    """Bounds on every joint in planned motion; disturbances add to the executed motion."""

    velocity_rad_s: float
    acceleration_rad_s2: float

    def __post_init__(self) -> None:
        for name in ("velocity_rad_s", "acceleration_rad_s2"):
            if not 0 < getattr(self, name) < math.inf:
                raise ArgumentError(f"limits.{name} is {getattr(self, name)}; it must be positive and finite")


# appearance of a scene

Rgb = tuple[float, float, float]  # linear
TextureKind = Literal["wood", "tile", "cloth", "noise", "stripes"]
TextureSet = Literal["seen", "unseen"]  # of demonstrations, of evaluation: no palette of a kind is in both
MOST_LAMPS = 3  # directional lights that a SAPIEN scene supports


@dataclass(frozen=True)
class Texture:
    """Description of a picture that repeats over a surface; the simulator generates its pixels.

    Raises ArgumentError for a kind or set that does not exist and for a size that is not positive.
    """

    kind: TextureKind
    set: TextureSet
    seed: int  # of pattern and palette
    tile_m: float  # side of the square that the picture covers

    def __post_init__(self) -> None:
        for name, possible in (("kind", get_args(TextureKind)), ("set", get_args(TextureSet))):
            if (value := getattr(self, name)) not in possible:
                raise unknown_choice(f"{name} of a texture", value, possible)
        if not 0 < self.tile_m < float("inf"):
            raise ArgumentError(f"tile_m={self.tile_m} of a texture; expected more than 0 m")


@dataclass(frozen=True)
class Finish:
    """Appearance of a surface. None keeps the object's own value."""

    colour: Rgb | None = None  # in [0, 1]; multiplies the texture, white by default
    texture: Texture | None = None
    roughness: float | None = None  # 0: mirror, 1: matt

    def __post_init__(self) -> None:
        for name, values in (("colour", self.colour or ()), ("roughness", (self.roughness or 0.0,))):
            if not all(0 <= value <= 1 for value in values):
                raise ArgumentError(f"{name} of a finish is {getattr(self, name)}; expected 0 to 1")


DEFAULT_FINISH = Finish()


@dataclass(frozen=True)
class Look:
    """Finishes of table top, floor and walls; by default unchanged."""

    table: Finish = DEFAULT_FINISH
    floor: Finish = DEFAULT_FINISH
    walls: Finish = DEFAULT_FINISH


@dataclass(frozen=True)
class Lamp:
    """Directional light."""

    direction: tuple[float, float, float]  # in which the light travels, world frame, of any length
    colour: Rgb  # irradiance; may exceed 1

    def __post_init__(self) -> None:
        if not any(self.direction):
            raise ArgumentError(f"direction of a lamp is {self.direction}; expected one that is not zero")


@dataclass(frozen=True)
class Light:
    """Directional and ambient light of a scene. Nothing casts a shadow.

    Raises ArgumentError for more than MOST_LAMPS lamps.
    """

    ambient: Rgb = (0.3, 0.3, 0.3)
    lamps: tuple[Lamp, ...] = (
        Lamp((-0.6, 0.4, -1.0), (1.6, 1.6, 1.6)),
        Lamp((0.4, -0.7, -0.5), (0.6, 0.6, 0.6)),  # a weaker one from the other side
    )

    def __post_init__(self) -> None:
        if len(self.lamps) > MOST_LAMPS:
            raise ArgumentError(f"{len(self.lamps)} lamps; expected {MOST_LAMPS} at most")

    def brighter(self, factor: float) -> "Light":
        """The same light, brighter by a factor."""

        def scaled(colour: Rgb) -> Rgb:
            red, green, blue = colour
            return red * factor, green * factor, blue * factor

        lamps = tuple(Lamp(lamp.direction, scaled(lamp.colour)) for lamp in self.lamps)
        return Light(scaled(self.ambient), lamps)

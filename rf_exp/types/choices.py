"""What is chosen for an experiment: constraints, architecture, cameras, limits."""

from dataclasses import dataclass
from typing import Literal, get_args

from rf_exp.errors import ArgumentError, choices

SMALLEST_PX, LARGEST_PX = 16, 2048  # of a picture's side: episodes of the largest ones take gigabytes
UNVARIED = (
    "none"  # the variation of scenes that differ by where things start, and a little in light and colour
)
Kind = Literal["logical", "temporal", "spatial"]
CameraChoice = Literal["all", "global", "local"]
Occupancy = Literal["state", "depth"]  # spatial constraints know the scene by its poses, or by cameras


@dataclass(frozen=True)
class ConstraintSet:
    """A row of the paper's ablation: which constraints are on (DESIGN: logical always is).

    All of them for who names no row: the library has no configuration.
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
    coordinated: bool = False  # told by RoboBrain and RoboChecker who is at which subgoal, and who waits
    both_views: bool = False  # the other view as well: a separate policy with the own and the global camera


FOREIGN = Arch("foreign", shared_policy=True, global_view=True)  # of a policy that is somebody else's


@dataclass(frozen=True)
class Pictures:
    """What the cameras take: size in pixels, or nothing at all. Raises ArgumentError for other sizes."""

    width: int
    height: int
    render: bool
    cameras: CameraChoice  # those whose pictures demonstrations hold: local is those of the agents

    def __post_init__(self) -> None:
        if self.cameras not in get_args(CameraChoice):
            raise choices("cameras", self.cameras, get_args(CameraChoice))
        for name, side in (("width", self.width), ("height", self.height)):
            if not SMALLEST_PX <= side <= LARGEST_PX:
                raise ArgumentError(
                    f"picture.{name} is {side}; possible are {SMALLEST_PX} to {LARGEST_PX} pixels"
                )

    def of(self, agents: int) -> tuple[str, ...]:
        """The names of the cameras for so many agents."""
        return camera_names(self.cameras, agents) if self.render else ()


NO_PICTURES = Pictures(SMALLEST_PX, SMALLEST_PX, render=False, cameras="all")  # the size is of nothing


def camera_names(chosen: CameraChoice, agents: int) -> tuple[str, ...]:
    """The names of the cameras that are chosen, for so many agents."""
    local = tuple(f"agent{k}" for k in range(1, agents + 1))
    return {"all": ("global", *local), "global": ("global",), "local": local}[chosen]


@dataclass(frozen=True)
class Extras:
    """What demonstrations hold of the cameras beside pictures."""

    depth: bool
    segmentation: bool


NO_EXTRAS = Extras(depth=False, segmentation=False)


@dataclass(frozen=True)
class JointLimits:
    """Bounds on every joint of motion that is meant; disturbances add to what is executed."""

    velocity_rad_s: float
    acceleration_rad_s2: float

    def __post_init__(self) -> None:
        for name in ("velocity_rad_s", "acceleration_rad_s2"):
            if getattr(self, name) <= 0:
                raise ArgumentError(f"{name} is {getattr(self, name)}; it must be positive")

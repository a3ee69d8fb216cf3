"""The values that flow between the stages. Frozen, without behaviour beyond derived numbers.

Agents are numbered from 1 as in the paper (Agent_1); arrays over agents have agent k at index
k - 1. World frame: table top at z = 0. Units: metres, radians, seconds; control steps at 20 Hz.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from rf_exp.errors import ArgumentError, choices
from rf_exp.findings import Account, Violation
from rf_exp.transforms import Matrix

CONTROL_HZ = 20
CONTROL_DT_S = 1.0 / CONTROL_HZ
ARM_JOINTS = 7
SMALLEST_PX, LARGEST_PX = 16, 2048  # of a picture's side: episodes of the largest ones take gigabytes
GRIPPER_OPEN, GRIPPER_CLOSED = 1.0, -1.0  # gripper command, ManiSkill's normalised width

Kind = Literal["logical", "temporal", "spatial"]
CameraChoice = Literal["all", "global", "local"]
Occupancy = Literal["state", "depth"]  # spatial constraints know the scene by its poses, or by cameras


@dataclass(frozen=True)
class Row:
    """A row of the paper's ablation: which constraints are on (DESIGN: logical always is)."""

    name: str
    logical: bool = True
    spatial: bool = True
    temporal: bool = True


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

    width: int = 320
    height: int = 240
    render: bool = True
    cameras: CameraChoice = "all"  # those whose pictures demonstrations hold: local is those of the agents

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
        if not self.render:
            return ()
        local = tuple(f"agent{k}" for k in range(1, agents + 1))
        return {"all": ("global", *local), "global": ("global",), "local": local}[self.cameras]


@dataclass(frozen=True)
class Extras:
    """What demonstrations hold of the cameras beside pictures."""

    depth: bool = False
    segmentation: bool = False


@dataclass(frozen=True)
class JointLimits:
    """Bounds on every joint of executed motion. Defaults: those of the authors' release."""

    velocity_rad_s: float = 0.9
    acceleration_rad_s2: float = 0.9

    def __post_init__(self) -> None:
        for name in ("velocity_rad_s", "acceleration_rad_s2"):
            if getattr(self, name) <= 0:
                raise ArgumentError(f"{name} is {getattr(self, name)}; it must be positive")


@dataclass(frozen=True)
class Scene:
    """Everything measured at one control step. The world model of planners and checkers."""

    step: int
    qpos: NDArray[np.float64]  # (N, 9) rad for the arm, metres for the two fingers
    qvel: NDArray[np.float64]  # (N, 9)
    poses: Mapping[str, NDArray[np.float64]]  # object -> world_from_object (4, 4)
    speeds: Mapping[str, float]  # object -> linear speed, m/s
    held: tuple[str | None, ...]  # (N,) object pinched between the fingers of each agent
    finger_forces: Mapping[tuple[int, str], NDArray[np.float64]] = field(default_factory=dict)
    # (agent, object) -> (3,) N, with which the fingers of the agent push the object, world frame
    arm_contacts: tuple[tuple[int, int, float], ...] = ()  # (agent, agent, force N)
    seen: NDArray[np.int64] | None = None  # (K, 3) voxels that the depth cameras see occupied, if they looked


@dataclass(frozen=True)
class Subgoal:
    """One step of one agent, e.g. agent 1: `grasp barrier at left`."""

    agent: int
    verb: str  # grasp lift carry place strike press release home aside hold
    object: str | None = None
    point: str | None = None  # interaction point of `object`
    target: str | None = None  # where to carry, place or strike: an object or a named place
    target_point: str | None = None
    height_m: float | None = None  # lift: how far up; carry: how far above the target

    @property
    def names(self) -> frozenset[str]:
        """What it is about: objects, or a named place."""
        return frozenset(name for name in (self.object, self.target) if name is not None)

    @property
    def text(self) -> str:
        return self.what + (f" by {self.height_m:g} m" if self.height_m is not None else "")

    @property
    def what(self) -> str:
        """Its text without how far."""
        words = [self.verb]
        words += [self.object] if self.object else []
        words += ["at", self.point] if self.point else []
        words += ["to", self.target] if self.target else []
        words += ["at", self.target_point] if self.target_point else []
        return " ".join(words)


def what_of(text: str) -> str:
    """`Subgoal.what` of the text of a subgoal."""
    return text.partition(" by ")[0]


@dataclass(frozen=True)
class Segment:
    """One rest-to-rest motion of one agent on the control grid, made by one motion primitive.

    The arm stands still at both ends, so a schedule may wait between segments, never inside.
    """

    agent: int
    subgoal: Subgoal
    primitive: str  # move approach close lift carry lower open retreat press strike
    qpos: NDArray[np.float64]  # (T, 7) rad: the target at each control step; the start is not in it
    gripper: NDArray[np.float64]  # (T,) command in [-1 closed, 1 open]
    carries: str | None = None  # object that moves with the gripper
    tcp_from_object: NDArray[np.float64] | None = None  # (4, 4) of what is carried
    touches: frozenset[str] = frozenset()  # objects the gripper may touch here
    joined: str | None = None  # segments of several agents with one label run in lockstep

    def __len__(self) -> int:
        return len(self.qpos)

    @property
    def about(self) -> frozenset[str]:
        """What the agent has to do with here: objects, or a named place."""
        return self.touches | self.subgoal.names


@dataclass(frozen=True)
class Trajectory:
    """All segments of one agent for one proposal, from where it stands now."""

    agent: int
    start_qpos: NDArray[np.float64]  # (7,) rad
    start_gripper: float
    segments: tuple[Segment, ...]

    @property
    def knots(self) -> tuple[int, ...]:
        """Path positions at which the arm stands still: 0, then the end of each segment."""
        return tuple(np.cumsum([0, *map(len, self.segments)]).tolist())

    def __len__(self) -> int:
        return self.knots[-1]

    def segment_at(self, position: int) -> Segment | None:
        """The segment that ends at or after a path position, beyond all the last; None without segments."""
        if not self.segments:
            return None
        return self.segments[min(int(np.searchsorted(self.knots[1:], position)), len(self.segments) - 1)]

    def path(self) -> NDArray[np.float64]:
        """(len + 1, 8): joint target and gripper command at each path position; 0 is the start."""
        start = np.append(self.start_qpos, self.start_gripper)[None]
        rows = [np.column_stack([s.qpos, s.gripper]) for s in self.segments]
        return np.concatenate([start, *rows])


@dataclass(frozen=True)
class Schedule:
    """When each agent is where on its path. Column k - 1 belongs to agent k."""

    positions: NDArray[np.int64]  # (T + 1, N) path position at each control step; row 0 is zeros
    makespan_bound: int  # proven lower bound on T, control steps
    # (T + 1, N) who stays in the step that leads here though nobody is in its way; None: nobody ever does
    hesitates: NDArray[np.bool_] | None = None

    def __len__(self) -> int:
        return len(self.positions) - 1


class Measured(NamedTuple):  # a frozen dataclass takes three times as long, many times a control step
    """A number against its bound; as a condition of success it is as true as `holds`."""

    holds: bool
    value: float
    bound: float
    unit: str
    above: bool  # the value should be above the bound, otherwise below it

    def __bool__(self) -> bool:
        return self.holds

    @property
    def asked(self) -> str:
        return f"{'>' if self.above else '<'} {self.bound:g}"


Condition = bool | Measured  # of success
UNITS = ("", "m", "m/s", "deg", "rad", "s", "N", "kg")  # that a `Measured` may have


@dataclass(frozen=True)
class Verdict:
    """What the success criteria say about one step."""

    success: bool  # strict, held long enough
    success_paper: bool
    evidence: Mapping[str, bool]  # named condition -> holds now
    measured: Mapping[str, Measured] = field(default_factory=dict)  # the numbers of those that have one
    lost: Mapping[str, str] = field(default_factory=dict)  # object -> dropped | out of reach | off the table


@dataclass(frozen=True)
class Judged:
    """How far each of C conditions of success was met. Row t is what action t has led to."""

    names: tuple[str, ...]
    value: NDArray[np.float32]  # (T, C) 1 or 0 where a condition is a mere yes or no
    bound: NDArray[np.float32]  # (T, C) against which the value is held
    unit: NDArray[np.uint8]  # (T, C) of both, an index of UNITS: a condition may have several sides
    holds: NDArray[np.bool_]  # (T, C)


@dataclass(frozen=True)
class Episode:
    """One executed episode. Row t is observed before action t is applied."""

    task: str
    seed: int
    qpos: NDArray[np.float32]  # (T, N, 9) measured
    qvel: NDArray[np.float32]  # (T, N, 9)
    action: NDArray[np.float32]  # (T, N, 8) joint targets rad + gripper command, as intended
    pictures: Mapping[str, NDArray[np.uint8]]  # camera -> (T, H, W, 3); empty without rendering
    certificate: Mapping[str, object] = field(default_factory=dict)  # JSON: checks and results, subgoals
    executed: NDArray[np.float32] | None = None  # (T, N, 8) what the arms were told; None: `action`
    poses: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)
    # object -> (T, 7) position in m and quaternion w, x, y, z, world frame
    subgoal: NDArray[np.int16] | None = None  # (T, N) each agent's, an index of certificate["subgoals"]
    judged: Judged | None = None
    images: Mapping[str, NDArray] = field(default_factory=dict)
    # depth_<camera> -> (T, H, W) u16 mm, segmentation_<camera> -> (T, H, W) u8; those that were asked for

    @property
    def commanded(self) -> NDArray[np.float32]:
        """(T, N, 8) what the arms were told: played again from the seed, it gives this episode again."""
        return self.action if self.executed is None else self.executed


@dataclass(frozen=True)
class Sight:
    """Where in a picture a policy sees that an agent will be, or another one is."""

    camera: str
    agent: int
    x: float  # to the right, from 0 to 1 over the picture
    y: float  # down
    goes: bool  # whether it is where this agent goes next


@dataclass(frozen=True)
class RolloutStep:
    """One control step of a rollout, as its observers are told of it."""

    scene: Scene  # after the step
    action: NDArray[np.float64]  # (N, 8) as commanded: joint targets rad + gripper command
    predicted: Mapping[
        int, NDArray[np.float64]
    ]  # agent -> (T, 8) targets from this step on, where it predicted
    verdict: Verdict
    violation: Violation | None  # seen by the monitor
    withheld: Mapping[int, str] | None = None  # agent -> why a shield kept its command; None without one
    seen: tuple[Sight, ...] = ()  # what heat maps saw when a policy looked for the last time
    # agent -> the number of its subgoal and whether it may go on, as its policy said at its last prediction
    phases: Mapping[int, tuple[int, bool]] = field(default_factory=dict)


@dataclass(frozen=True)
class Rollout:
    """What happened when a policy acted in one scene."""

    seed: int
    success: bool
    success_paper: bool
    steps: int
    violations: int  # control steps with a violation, seen by the monitor
    contacts: int  # control steps in which arms touched each other
    account: Account = field(
        default_factory=Account
    )  # which arms touched, which violations were seen, what failed
    interventions: int = 0  # control steps in which a shield kept an agent from its command

    @property
    def reason(self) -> str:
        """Why it failed, in words; empty for a success."""
        return "" if self.success else self.account.reason


@dataclass(frozen=True)
class CameraModel:
    """A pinhole camera: square pixels, principal point in the middle."""

    width_px: int
    height_px: int
    fov_y_rad: float
    world_from_camera: Matrix  # (4, 4), OpenCV axes: x right, y down, z forward

    @property
    def intrinsics(self) -> NDArray[np.float64]:
        """(3, 3) pixels from camera coordinates."""
        focal = self.height_px / 2 / np.tan(self.fov_y_rad / 2)
        return np.array([[focal, 0, self.width_px / 2], [0, focal, self.height_px / 2], [0, 0, 1.0]])


class World(Protocol):
    """What a rollout and the generation loop need of an environment (given by `rf_exp.sim`)."""

    @property
    def cameras(self) -> tuple[str, ...]:
        """Camera names: `global`, `agent1`, ... `agentN`; empty without rendering."""
        ...

    def reset(self, seed: int) -> Scene: ...

    def step(self, action: NDArray[np.float64]) -> Scene:
        """Apply (N, 8) joint targets + gripper command for one control step."""
        ...

    def pictures(self, cameras: Iterable[str] | None = None) -> dict[str, NDArray[np.uint8]]:
        """Camera -> (H, W, 3) of the present step; of these cameras, or of all."""
        ...


class SeeingWorld(World, Protocol):
    """A world that can also be measured by its cameras, which the generation loop may ask for."""

    def depth(self) -> dict[str, NDArray[np.float32]]:
        """Camera -> (H, W) metres along the viewing direction at the present step; 0 is nothing."""
        ...

    def camera_models(self) -> dict[str, CameraModel]:
        """Camera -> its model at the present step."""
        ...

"""Observation spec: the context of a policy, a vector that it observes beside pictures and its own joints.

For each own agent, in the footprint of the first of them: the pose of the TCP (position, two axes), and the
gripper history (`GripperHistory`). A footprint is the place of a base on the table (ROS, REP 120): with a
higher table TCPs are lower, and objects on it keep their height. A privileged-state policy (encoder
`privileged`) observes the true state instead of pictures: the joints and TCPs of the other agents, the poses
of all objects, and their offsets from the own TCPs, clipped to `NEAR_M`. Values are scaled by their range in
the demonstrations; for an object that moves along the whole table, a millimetre would be less than a
thousandth.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from rf_exp.artifacts import drop_defaults
from rf_exp.errors import ArgumentError
from rf_exp.policy.config import PolicyConfig
from rf_exp.policy.inputs.coordination import numbered_subgoals
from rf_exp.policy.inputs.view import MOST_AGENTS, PROPRIO_SIZE, Stream, View
from rf_exp.robots import DEFAULT, Robot, known_robots, robot_named
from rf_exp.transforms import Matrix, inverse, planar
from rf_exp.types import ARM_JOINTS, fingers_of, gripper_of

if TYPE_CHECKING:
    from rf_exp.store import Store

Floats = NDArray[np.floating]
Array = TypeVar("Array", Tensor, Floats)

NEAR_M = 0.1  # clip of offsets from a TCP
MOST_OBJECTS, MOST_SUBGOALS = 256, 256  # bounds: objects of a task, subgoals of an agent
MOST_CHANGES = 6  # gripper changes that are distinguished
RECENT_STEPS = 20  # clip of the time since the last change
HISTORY_SIZE = MOST_CHANGES + 2
EMPTY_OPENING_M = 0.004  # closed fingers with a smaller opening hold nothing
# Position in m and the first two axes of the rotation (Zhou et al. 2019: no jumps, unlike angles).
POSE_SIZE = 9


@dataclass(frozen=True)
class ObservationSpec:
    """Specification of the context of a policy. `bases` is empty for a policy without one."""

    bases: tuple[tuple[float, float, float], ...] = ()  # x (m), y (m), yaw (rad) of every arm of the task
    objects: tuple[str, ...] = ()  # whose true poses are in the context
    keyframes: int = 0  # changes of an own gripper that the encoder predicts
    subgoals: int = 0  # number of subgoals in the phase of an own agent; 0: no phases
    names: tuple[tuple[str, ...], ...] = ()  # of the subgoals, by agent; empty where stored numbers agree
    robots: tuple[str, ...] = ()  # name for every arm of the task; empty where all are the default
    rests: tuple[tuple[float, ...], ...] = ()
    # (dof,) rad, rest posture of every arm of the task; empty where all are those of their robots.
    shuts: tuple[tuple[int, ...], ...] = ()
    # For every arm the numbers of gripper changes after which its fingers are meant to be closed on nothing
    # (to press, or push); empty where there are none.

    def __post_init__(self) -> None:
        if len(self.bases) > MOST_AGENTS or not np.isfinite(np.array(self.bases, float)).all():
            raise ArgumentError(f"bases are {self.bases}; expected finite ones of at most {MOST_AGENTS} arms")
        sizes = {"objects": MOST_OBJECTS, **dict.fromkeys(("names", "robots", "rests", "shuts"), MOST_AGENTS)}
        for name, most in sizes.items():
            if len(getattr(self, name)) > most:
                raise ArgumentError(f"there are {len(getattr(self, name))} {name}; expected at most {most}")
        for name, most in (("keyframes", MOST_CHANGES), ("subgoals", MOST_SUBGOALS)):
            if not 0 <= (value := getattr(self, name)) <= most:
                raise ArgumentError(f"{name} is {value}; expected 0 to {most}")

    @property
    def identity(self) -> dict[str, Any]:
        """Its fields, but for later additions at their neutral values."""
        return drop_defaults(asdict(self), subgoals=0, names=(), robots=(), rests=(), shuts=())

    @property
    def world_from_base(self) -> list[Matrix]:
        """Usual base pose (4, 4) of every arm."""
        return [planar(*base) for base in self.bases]

    def robot(self, agent: int) -> Robot:
        """The robot of an agent. Raises ArgumentError for one that is not registered."""
        return robot_named(self.robots[agent - 1]) if self.robots else DEFAULT

    def rest_rad(self, agent: int) -> NDArray[np.float64]:
        """Rest posture (7,) of an agent; zero behind the joints that it has."""
        rest = np.array(self.rests[agent - 1] if self.rests else self.robot(agent).rest_rad)
        return np.pad(rest, (0, ARM_JOINTS - len(rest)))

    def keypoints(self, view: View) -> int:
        """Number of keypoints per camera: keyframes and end of the own agents, then the TCPs of all."""
        return len(view.streams[0].agents) * (self.keyframes + 1) + len(self.bases)

    def size(self, view: View) -> int:
        """Length of the context of a stream of a view."""
        if not self.bases:
            return 0
        own = len(view.streams[0].agents)
        true_state = (len(self.bases) - own) * (PROPRIO_SIZE + POSE_SIZE) + len(self.objects) * (
            POSE_SIZE + 3 * own
        )
        which_stream = len(view.streams) if len(view.streams) > 1 else 0
        return (
            own * (POSE_SIZE + HISTORY_SIZE + self.phase_size)
            + (true_state if self.objects else 0)
            + which_stream
        )

    @property
    def phase_size(self) -> int:
        """Length of the phase of an own agent: one-hot subgoal, and whether it may go on."""
        return self.subgoals + (self.subgoals > 0)


def spec_of(config: PolicyConfig, store: "Store", view: View) -> ObservationSpec:
    """The spec of a policy that learns a view. Raises ArgumentError where the store lacks data for it."""
    robot_names = _robot_names(store)
    if not config.context:
        if view.coordinated:
            raise ArgumentError("a coordinated architecture needs policy.context=true; recipe fast has it")
        return ObservationSpec(robots=robot_names)
    subgoals, names = 0, ()
    if view.coordinated or config.phases:
        numbers, names = numbered_subgoals(store)
        subgoals = int(numbers.max()) + 1
    try:
        robots = store.identity["scene"]["robots"]
    except KeyError as error:
        raise ArgumentError(
            f"{store.path} does not record the base poses of its arms; generate it again, or train "
            "policy=paper, which does not need them"
        ) from error
    bases = tuple((robot["x_m"], robot["y_m"], float(np.deg2rad(robot["yaw_deg"]))) for robot in robots)
    objects, keyframes = store.objects if config.encoder.privileged else (), 0
    if config.encoder.privileged and not objects:
        raise ArgumentError(
            f"encoder privileged needs the poses of the objects, and {store.path} has none; generate it again"
        )
    if config.encoder.keypoints:  # most changes of a gripper in an episode
        episodes = zip(store.by_episode(store.action), store.by_episode(store.qpos), strict=True)
        keyframes = max(
            len(gripper_changes(gripper_of(action)[:, agent - 1], finger_openings(qpos)[:, agent - 1]))
            for action, qpos in episodes
            for agent in view.agents
        )
    rests, shuts = _rest_postures(robots, robot_names), _empty_closings(store)
    return ObservationSpec(
        bases, objects, min(keyframes, MOST_CHANGES), subgoals, names, robot_names, rests, shuts
    )


def _rest_postures(
    robots: Sequence[Mapping[str, Any]], names: Sequence[str]
) -> tuple[tuple[float, ...], ...]:
    """Rest posture of every arm of an identity; empty where all are those of their robots, or unrecorded."""
    defaults = [robot_named(name).rest_rad for name in names] or [DEFAULT.rest_rad] * len(robots)
    recorded = [tuple(robot.get("rest_rad", rest)) for robot, rest in zip(robots, defaults, strict=True)]
    return () if recorded == defaults else tuple(recorded)


def _empty_closings(store: "Store") -> tuple[tuple[int, ...], ...]:
    """For every arm the numbers of gripper changes after which most demonstrations close on nothing."""
    counters = [Counter[int]() for _ in range(store.agents)]
    for action, qpos in zip(store.by_episode(store.action), store.by_episode(store.qpos), strict=True):
        commands, openings = gripper_of(action), finger_openings(qpos)
        numbers = gripper_histories(commands, openings)[..., : MOST_CHANGES + 1].argmax(axis=-1)  # (T, N)
        closed_empty = (np.roll(commands, 1, axis=0) <= 0) & (openings < EMPTY_OPENING_M)
        for agent, counter in enumerate(counters):
            counter.update({*numbers[1:, agent][closed_empty[1:, agent]].tolist()})
    majorities = [
        tuple(sorted(number for number, count in counter.items() if 2 * count > len(store.seeds)))
        for counter in counters
    ]
    return tuple(majorities) if any(majorities) else ()


def _robot_names(store: "Store") -> tuple[str, ...]:
    """Robot of every agent of a store; empty where all are the default. Raises ArgumentError if unknown."""
    names = {robot.qpos_names: robot.name for robot in known_robots()}
    robot_names = [names.get(model.joints) for model in store.models]
    if None in robot_names:
        titles = ", ".join(sorted({model.title for model in store.models if model.joints not in names}))
        known = ", ".join(robot.title for robot in known_robots())
        raise ArgumentError(f"{store.path} is of {titles}; policies can be trained for: {known}")
    return () if {*robot_names} == {DEFAULT.name} else tuple(map(str, robot_names))


class GripperHistory:
    """Gripper history, from commands: the number of changes so far, one-hot, and the time since the last.

    Pictures before and after the fingers close look much alike, although what follows differs. A failed grasp
    (fingers that closed on nothing and open again) is taken back from the count, so that the same change
    comes next once more.
    """

    def __init__(self, agents: int) -> None:
        self.opened = np.ones(agents, dtype=bool)  # (N,) by the last command; episodes begin open
        self.changes = np.zeros(agents, dtype=int)  # (N,)
        self._steps_since = np.full(agents, RECENT_STEPS)

    def record(self, grippers: Mapping[int, float], openings: Floats) -> None:
        """Record the commands of one control step, of those agents whose commands are known.

        `finger_openings` (N,) are the finger openings measured before it, in m.
        """
        opened = self.opened.copy()
        for agent, command in grippers.items():
            opened[agent - 1] = command > 0
        changed = opened != self.opened
        self.opened = opened
        self.changes = self.changes + np.where(opened & (openings < EMPTY_OPENING_M), -1, 1) * changed
        self._steps_since = np.where(changed, 0, np.minimum(self._steps_since + 1, RECENT_STEPS))

    @property
    def vector(self) -> NDArray[np.float64]:
        """(N, MEMORY)."""
        count = np.eye(MOST_CHANGES + 1)[np.minimum(self.changes, MOST_CHANGES)]
        return np.column_stack([count, self._steps_since / RECENT_STEPS])


def gripper_histories(commands: Floats, openings: Floats) -> NDArray[np.float32]:
    """Memory (T, N, MEMORY) before each step of an episode, by commands and widths in m, (T, N) each."""
    history, rows = GripperHistory(commands.shape[1]), []
    for command, opening in zip(commands, openings, strict=True):
        rows.append(history.vector)
        history.record(dict(enumerate(command, start=1)), opening)
    return np.array(rows, np.float32)


def gripper_changes(gripper: Floats, opening: Floats) -> NDArray[np.int64]:
    """Steps of gripper changes, without failed grasps, by commands and widths in m, (T,) each."""
    steps: list[int] = []
    for step in np.flatnonzero(np.diff(gripper > 0, prepend=True)):
        if gripper[step] > 0 and opening[step] < EMPTY_OPENING_M and steps:
            steps.pop()
        else:
            steps.append(int(step))
    return np.array(steps, np.int64)


def finger_openings(qpos: Floats) -> Floats:
    """Finger openings in m: measured joints (..., N, D) -> (..., N)."""
    return fingers_of(qpos).sum(axis=-1)


def proprioception(qpos: Floats) -> NDArray[np.float32]:
    """Measured joint positions (..., N, 9) -> (..., 8N): seven joints (rad) and the opening (m) per agent.

    Both fingers of the gripper keep the same width (paper, supplementary), so their sum suffices.
    """
    joined = np.concatenate([qpos[..., :ARM_JOINTS], finger_openings(qpos)[..., None]], axis=-1)
    return joined.reshape(*qpos.shape[:-2], -1).astype(np.float32)


def context(
    spec: ObservationSpec,
    view: View,
    row: int,
    qpos: Floats,
    poses: Mapping[str, Floats],
    history: Floats,
    bases: Sequence[Matrix],
) -> NDArray[np.float32]:
    """The context (..., C) of stream `row` of a view, for these base poses (4, 4) of all arms.

    From the measured joints of all agents (..., N, 9), world poses of objects (..., 4, 4) and, in `history`
    (..., N, M), their gripper histories, see `GripperHistory`, followed by their phases, which come last in
    the context.
    """
    if not spec.bases:
        return np.zeros((*qpos.shape[:-2], 0), np.float32)
    stream, parts = view.streams[row], list[Floats]()
    footprint_from_world = inverse(footprint(bases[stream.agents[0] - 1]))

    def tcp_of(agent: int) -> Floats:
        return flat_pose(footprint_from_world @ world_from_tcp(spec, bases, agent, qpos))

    tcps = [tcp_of(agent) for agent in stream.agents]
    for agent, tcp in zip(stream.agents, tcps, strict=True):
        parts += [tcp, history[..., agent - 1, :HISTORY_SIZE]]
    if spec.objects:
        for agent in other_agents(spec, stream):
            parts += [proprioception(qpos[..., agent - 1 : agent, :]), tcp_of(agent)]
        objects = [flat_pose(footprint_from_world @ poses[name]) for name in spec.objects]
        parts += [
            *objects,
            *(clipped_offsets(pose[..., :3] - tcp[..., :3]) for tcp in tcps for pose in objects),
        ]
    if len(view.streams) > 1:  # a shared policy: for which of its streams
        parts.append(np.broadcast_to(np.eye(len(view.streams))[row], (*qpos.shape[:-2], len(view.streams))))
    parts += [history[..., agent - 1, HISTORY_SIZE:] for agent in stream.agents]
    return np.concatenate(parts, axis=-1).astype(np.float32)


def footprint(world_from_base: Matrix) -> Matrix:
    """Footprint of a base (4, 4): its place on the table, which is at z = 0 of the world."""
    world_from_footprint = world_from_base.copy()
    world_from_footprint[2, 3] = 0.0
    return world_from_footprint


def tcp_poses(spec: ObservationSpec, bases: Sequence[Matrix], stream: Stream, joints: Floats) -> Floats:
    """TCP poses (..., n, POSE) of the agents of a stream for joints (..., n, 7), in its footprint."""
    return flat_pose(footprint_from_tcps(spec, bases, stream, joints))


def footprint_from_tcps(
    spec: ObservationSpec, bases: Sequence[Matrix], stream: Stream, joints: Floats
) -> NDArray[np.float64]:
    """The same as `tcp_poses`, as matrices (..., n, 4, 4)."""
    footprint_from_world = inverse(footprint(bases[stream.agents[0] - 1]))
    poses = [
        footprint_from_world @ bases[agent - 1] @ spec.robot(agent).tcp_pose(joints[..., row, :])
        for row, agent in enumerate(stream.agents)
    ]
    return np.stack(poses, axis=-3)


def other_agents(spec: ObservationSpec, stream: Stream) -> list[int]:
    """The agents of the task that a stream does not command."""
    return [agent for agent in range(1, len(spec.bases) + 1) if agent not in stream.agents]


def clipped_offsets(offset_m: Array) -> Array:
    """Offsets (...) in m, clipped to NEAR_M and scaled to [-1, 1]."""
    return offset_m.clip(-NEAR_M, NEAR_M) / NEAR_M


def world_from_tcp(
    spec: ObservationSpec, bases: Sequence[Matrix], agent: int, qpos: Floats
) -> NDArray[np.float64]:
    """TCP pose (..., 4, 4) of an agent in the world; bases (4, 4) and joints (..., N, 7 or more) of all."""
    return bases[agent - 1] @ spec.robot(agent).tcp_pose(qpos[..., agent - 1, :ARM_JOINTS])


def flat_pose(poses: Floats) -> Floats:
    """Poses (..., 4, 4) -> (..., POSE)."""
    axes = poses[..., :3, :2].swapaxes(-1, -2).reshape(*poses.shape[:-2], 6)
    return np.concatenate([poses[..., :3, 3], axes], axis=-1)


def own_tcp_and_changes(context: Tensor, row: int) -> tuple[Tensor, Tensor]:
    """TCP pose (..., POSE) and one-hot gripper changes of the own agent `row`, in a context (..., C)."""
    first = row * (POSE_SIZE + HISTORY_SIZE)
    return context[..., first : first + POSE_SIZE], context[
        ..., first + POSE_SIZE : first + POSE_SIZE + MOST_CHANGES + 1
    ]

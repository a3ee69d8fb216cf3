"""Observation spec: the context of a policy, a vector that it observes beside pictures and its own joints.

For each own agent, in the footprint of the first of them: the pose of the TCP (position, two axes), and the
gripper history (`Memory`). A footprint is the place of a base on the table (ROS, REP 120): with a higher
table TCPs are lower, and objects on it keep their height. A privileged-state policy (encoder `privileged`)
observes the true state instead of pictures: the joints and TCPs of the other agents, the poses of all
objects, and their offsets from the own TCPs, clipped to `NEAR_M`. Values are scaled by their range in the
demonstrations; for an object that moves along the whole table, a millimetre would be less than a thousandth.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from rf_exp.artifacts import without
from rf_exp.errors import ArgumentError
from rf_exp.policy.config import PolicyConfig
from rf_exp.policy.inputs.coordination import numbered
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
CHANGES = 6  # gripper changes that are distinguished
RECENT_STEPS = 20  # clip of the time since the last change
MEMORY = CHANGES + 2
EMPTY_M = 0.004  # closed fingers with a smaller opening hold nothing
POSE = 9  # position in m and the first two axes of the rotation (Zhou et al. 2019: no jumps, unlike angles)


@dataclass(frozen=True)
class ObservationSpec:
    """Specification of the context of a policy. `bases` is empty for a policy without one."""

    bases: tuple[tuple[float, float, float], ...] = ()  # x (m), y (m), yaw (rad) of every arm of the task
    objects: tuple[str, ...] = ()  # whose true poses are in the context
    keyframes: int = 0  # changes of an own gripper that the encoder predicts
    subgoals: int = 0  # number of subgoals in the phase of an own agent; 0: no phases
    names: tuple[tuple[str, ...], ...] = ()  # of the subgoals, by agent; empty where stored numbers agree
    robots: tuple[str, ...] = ()  # name for every arm of the task; empty where all are the default
    # (dof,) rad, rest posture of every arm of the task; empty where all are those of their robots.
    rests: tuple[tuple[float, ...], ...] = ()
    # For every arm the numbers of gripper changes after which its fingers are meant to be closed on nothing
    # (to press, or push); empty where there are none.
    shuts: tuple[tuple[int, ...], ...] = ()

    def __post_init__(self) -> None:
        if len(self.bases) > MOST_AGENTS or not np.isfinite(np.array(self.bases, float)).all():
            raise ArgumentError(f"bases are {self.bases}; expected finite ones of at most {MOST_AGENTS} arms")
        sizes = {"objects": MOST_OBJECTS, **dict.fromkeys(("names", "robots", "rests", "shuts"), MOST_AGENTS)}
        for name, high in sizes.items():
            if len(getattr(self, name)) > high:
                raise ArgumentError(f"there are {len(getattr(self, name))} {name}; expected at most {high}")
        for name, high in (("keyframes", CHANGES), ("subgoals", MOST_SUBGOALS)):
            if not 0 <= (value := getattr(self, name)) <= high:
                raise ArgumentError(f"{name} is {value}; expected 0 to {high}")

    @property
    def identity(self) -> dict[str, Any]:
        """Its fields, but for later additions at their neutral values."""
        return without(asdict(self), subgoals=0, names=(), robots=(), rests=(), shuts=())

    @property
    def world_from_base(self) -> list[Matrix]:
        """Usual base pose (4, 4) of every arm."""
        return [planar(*each) for each in self.bases]

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
        truth = (len(self.bases) - own) * (PROPRIO_SIZE + POSE) + len(self.objects) * (POSE + 3 * own)
        which = len(view.streams) if len(view.streams) > 1 else 0
        return own * (POSE + MEMORY + self.phase_size) + (truth if self.objects else 0) + which

    @property
    def phase_size(self) -> int:
        """Length of the phase of an own agent: one-hot subgoal, and whether it may go on."""
        return self.subgoals + (self.subgoals > 0)


def spec_of(config: PolicyConfig, store: "Store", view: View) -> ObservationSpec:
    """The spec of a policy that learns a view. Raises ArgumentError where the store lacks data for it."""
    models = _robots(store)
    if not config.context:
        if view.coordinated:
            raise ArgumentError("a coordinated architecture needs policy.context=true; recipe fast has it")
        return ObservationSpec(robots=models)
    subgoals, names = 0, ()
    if view.coordinated or config.phases:
        numbers, names = numbered(store)
        subgoals = int(numbers.max()) + 1
    try:
        robots = store.identity["scene"]["robots"]
    except KeyError as error:
        raise ArgumentError(
            f"{store.path} does not say where its arms stand; generate it again, or learn with policy=paper, "
            "which is not told"
        ) from error
    bases = tuple((each["x_m"], each["y_m"], float(np.deg2rad(each["yaw_deg"]))) for each in robots)
    objects, keyframes = store.objects if config.encoder.privileged else (), 0
    if config.encoder.privileged and not objects:
        raise ArgumentError(
            f"encoder privileged needs the poses of the objects, and {store.path} has none; generate it again"
        )
    if config.encoder.keypoints:  # most changes of a gripper in an episode
        episodes = zip(store.by_episode(store.action), store.by_episode(store.qpos), strict=True)
        keyframes = max(
            len(changes(gripper_of(action)[:, agent - 1], widths(qpos)[:, agent - 1]))
            for action, qpos in episodes
            for agent in view.agents
        )
    rests, shuts = _rests(robots, models), _shuts(store)
    return ObservationSpec(bases, objects, min(keyframes, CHANGES), subgoals, names, models, rests, shuts)


def _rests(robots: Sequence[Mapping[str, Any]], models: Sequence[str]) -> tuple[tuple[float, ...], ...]:
    """Rest posture of every arm of an identity; empty where all are those of their robots, or unrecorded."""
    usual = [robot_named(name).rest_rad for name in models] or [DEFAULT.rest_rad] * len(robots)
    told = [tuple(each.get("rest_rad", rest)) for each, rest in zip(robots, usual, strict=True)]
    return () if told == usual else tuple(told)


def _shuts(store: "Store") -> tuple[tuple[int, ...], ...]:
    """For every arm the numbers of gripper changes after which most demonstrations close on nothing."""
    found = [Counter[int]() for _ in range(store.agents)]
    for action, qpos in zip(store.by_episode(store.action), store.by_episode(store.qpos), strict=True):
        commands, apart = gripper_of(action), widths(qpos)
        numbers = remembered(commands, apart)[..., : CHANGES + 1].argmax(axis=-1)  # (T, N)
        empty = (np.roll(commands, 1, axis=0) <= 0) & (apart < EMPTY_M)
        for agent, counted in enumerate(found):
            counted.update({*numbers[1:, agent][empty[1:, agent]].tolist()})
    most = [tuple(sorted(n for n, times in each.items() if 2 * times > len(store.seeds))) for each in found]
    return tuple(most) if any(most) else ()


def _robots(store: "Store") -> tuple[str, ...]:
    """Robot of every agent of a store; empty where all are the default. Raises ArgumentError if unknown."""
    names = {robot.measured: robot.name for robot in known_robots()}
    found = [names.get(model.joints) for model in store.models]
    if None in found:
        titles = ", ".join(sorted({model.title for model in store.models if model.joints not in names}))
        known = ", ".join(robot.title for robot in known_robots())
        raise ArgumentError(f"{store.path} is of {titles}; policies learn to move what is known: {known}")
    return () if {*found} == {DEFAULT.name} else tuple(map(str, found))


class Memory:
    """Gripper history, from commands: the number of changes so far, one-hot, and the time since the last.

    Pictures before and after the fingers close look much alike, although what follows differs. A failed grasp
    (fingers that closed on nothing and open again) is taken back from the count, so that the same change
    comes next once more.
    """

    def __init__(self, agents: int) -> None:
        self.opened = np.ones(agents, dtype=bool)  # (N,) by the last command; episodes begin open
        self.changes = np.zeros(agents, dtype=int)  # (N,)
        self._since = np.full(agents, RECENT_STEPS)

    def told(self, grippers: Mapping[int, float], widths: Floats) -> None:
        """Record the commands of one control step, of those agents whose commands are known.

        `widths` (N,) are the finger openings measured before it, in m.
        """
        opened = self.opened.copy()
        for agent, command in grippers.items():
            opened[agent - 1] = command > 0
        changed = opened != self.opened
        self.opened = opened
        self.changes = self.changes + np.where(opened & (widths < EMPTY_M), -1, 1) * changed
        self._since = np.where(changed, 0, np.minimum(self._since + 1, RECENT_STEPS))

    @property
    def vector(self) -> NDArray[np.float64]:
        """(N, MEMORY)."""
        count = np.eye(CHANGES + 1)[np.minimum(self.changes, CHANGES)]
        return np.column_stack([count, self._since / RECENT_STEPS])


def remembered(grippers: Floats, widths: Floats) -> NDArray[np.float32]:
    """Memory (T, N, MEMORY) before each step of an episode, by commands and widths in m, (T, N) each."""
    memory, rows = Memory(grippers.shape[1]), []
    for commands, apart in zip(grippers, widths, strict=True):
        rows.append(memory.vector)
        memory.told(dict(enumerate(commands, start=1)), apart)
    return np.array(rows, np.float32)


def changes(gripper: Floats, width: Floats) -> NDArray[np.int64]:
    """Steps of gripper changes, without failed grasps, by commands and widths in m, (T,) each."""
    found: list[int] = []
    for step in np.flatnonzero(np.diff(gripper > 0, prepend=True)):
        if gripper[step] > 0 and width[step] < EMPTY_M and found:
            found.pop()
        else:
            found.append(int(step))
    return np.array(found, np.int64)


def widths(qpos: Floats) -> Floats:
    """Finger openings in m: measured joints (..., N, D) -> (..., N)."""
    return fingers_of(qpos).sum(axis=-1)


def proprioception(qpos: Floats) -> NDArray[np.float32]:
    """Measured joint positions (..., N, 9) -> (..., 8N): seven joints (rad) and the opening (m) per agent.

    Both fingers of the gripper keep the same width (paper, supplementary), so their sum suffices.
    """
    joined = np.concatenate([qpos[..., :ARM_JOINTS], widths(qpos)[..., None]], axis=-1)
    return joined.reshape(*qpos.shape[:-2], -1).astype(np.float32)


def context(
    spec: ObservationSpec,
    view: View,
    row: int,
    qpos: Floats,
    poses: Mapping[str, Floats],
    memory: Floats,
    bases: Sequence[Matrix],
) -> NDArray[np.float32]:
    """The context (..., C) of stream `row` of a view, for these base poses (4, 4) of all arms.

    From the measured joints of all agents (..., N, 9), world poses of objects (..., 4, 4) and, in `memory`
    (..., N, M), their gripper histories, see `Memory`, followed by their phases, which come last in the
    context.
    """
    if not spec.bases:
        return np.zeros((*qpos.shape[:-2], 0), np.float32)
    stream, parts = view.streams[row], list[Floats]()
    footprint_from_world = inverse(footprint(bases[stream.agents[0] - 1]))

    def hand_of(agent: int) -> Floats:
        return flat_pose(footprint_from_world @ world_from_tcp(spec, bases, agent, qpos))

    hands = [hand_of(agent) for agent in stream.agents]
    for agent, hand in zip(stream.agents, hands, strict=True):
        parts += [hand, memory[..., agent - 1, :MEMORY]]
    if spec.objects:
        for agent in others(spec, stream):
            parts += [proprioception(qpos[..., agent - 1 : agent, :]), hand_of(agent)]
        things = [flat_pose(footprint_from_world @ poses[name]) for name in spec.objects]
        parts += [*things, *(near(thing[..., :3] - hand[..., :3]) for hand in hands for thing in things)]
    if len(view.streams) > 1:  # a shared policy: for which of its streams
        parts.append(np.broadcast_to(np.eye(len(view.streams))[row], (*qpos.shape[:-2], len(view.streams))))
    parts += [memory[..., agent - 1, MEMORY:] for agent in stream.agents]
    return np.concatenate(parts, axis=-1).astype(np.float32)


def footprint(world_from_base: Matrix) -> Matrix:
    """Footprint of a base (4, 4): its place on the table, which is at z = 0 of the world."""
    below = world_from_base.copy()
    below[2, 3] = 0.0
    return below


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


def others(spec: ObservationSpec, stream: Stream) -> list[int]:
    """The agents of the task that a stream does not command."""
    return [agent for agent in range(1, len(spec.bases) + 1) if agent not in stream.agents]


def near(offset_m: Array) -> Array:
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


def of_agent(context: Tensor, row: int) -> tuple[Tensor, Tensor]:
    """TCP pose (..., POSE) and one-hot gripper changes of the own agent `row`, in a context (..., C)."""
    first = row * (POSE + MEMORY)
    return context[..., first : first + POSE], context[..., first + POSE : first + POSE + CHANGES + 1]

"""The context of an observation: one vector of what a policy is told beside its pictures and its own joints.

For each own agent, in the footprint of the first of them: where the TCP is (position, two axes), and what its
gripper has done so far (`Memory`). A footprint is the place of a base on the table (ROS, REP 120): over a
table that is higher, hands are told to be lower, and what stands on it is as high as ever. A privileged-state
policy (encoder `privileged`) is told the truth instead of pictures: the joints and TCPs of the other agents,
the poses of all objects, and once more where those are that an own hand is near to. Numbers are scaled by
their range in the demonstrations: of a thing that goes along the whole table, a millimetre would be less than
a thousandth.
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

NEAR_M = 0.1  # from a hand to what it is near to
MOST_OBJECTS, MOST_SUBGOALS = 256, 256  # of a task, of an agent; more are none that anybody has
CHANGES = 6  # of a gripper that are told apart
RECENT_STEPS = 20  # since the last of them: what is longer ago is all the same
MEMORY = CHANGES + 2
EMPTY_M = 0.004  # fingers that have shut on nothing are nearer to each other
POSE = 9  # position in m and the first two axes of the rotation (Zhou et al. 2019: no jumps, unlike angles)


@dataclass(frozen=True)
class ObservationSpec:
    """What the context of a policy is made of. `bases` is empty for a policy that has none."""

    bases: tuple[tuple[float, float, float], ...] = ()  # x (m), y (m), yaw (rad) of every arm of the task
    objects: tuple[str, ...] = ()  # whose true poses it is told
    keyframes: int = 0  # changes of an own gripper that its encoder looks for
    subgoals: int = 0  # of an own agent, of which it is told
    names: tuple[tuple[str, ...], ...] = ()  # of them, of each agent; empty where they count as they come
    robots: tuple[str, ...] = ()  # of every arm of the task; empty where all are the usual one
    # (dof,) rad, how each arm of the task stands when it has nothing to do; empty where as its robot does.
    rests: tuple[tuple[float, ...], ...] = ()
    # Of each arm the numbers of its gripper's changes after which the fingers are meant to be shut on nothing
    # (they press, or push); empty where there are none.
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
        """Its fields, but for those that say nothing and came later."""
        return without(asdict(self), subgoals=0, names=(), robots=(), rests=(), shuts=())

    @property
    def world_from_base(self) -> list[Matrix]:
        """(4, 4) of every arm, where it usually stands."""
        return [planar(*each) for each in self.bases]

    def robot(self, agent: int) -> Robot:
        """Which robot an agent is. Raises ArgumentError for one that nobody has added."""
        return robot_named(self.robots[agent - 1]) if self.robots else DEFAULT

    def rest_rad(self, agent: int) -> NDArray[np.float64]:
        """(7,) joints of an agent that has nothing to do; zero behind those that it has."""
        rest = np.array(self.rests[agent - 1] if self.rests else self.robot(agent).rest_rad)
        return np.pad(rest, (0, ARM_JOINTS - len(rest)))

    def keypoints(self, view: View) -> int:
        """That an encoder looks for through each camera: of the own agents, then all hands now."""
        return len(view.streams[0].agents) * (self.keyframes + 1) + len(self.bases)

    def size(self, view: View) -> int:
        """Of the context of a stream of a view."""
        if not self.bases:
            return 0
        own = len(view.streams[0].agents)
        truth = (len(self.bases) - own) * (PROPRIO_SIZE + POSE) + len(self.objects) * (POSE + 3 * own)
        which = len(view.streams) if len(view.streams) > 1 else 0
        return own * (POSE + MEMORY + self.phase_size) + (truth if self.objects else 0) + which

    @property
    def phase_size(self) -> int:
        """Numbers by which it is told of a subgoal of an own agent, and whether that may go on."""
        return self.subgoals + (self.subgoals > 0)


def spec_of(config: PolicyConfig, store: "Store", view: View) -> ObservationSpec:
    """The spec of a policy that learns a view. Raises ArgumentError where the store lacks them."""
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
    """Of every arm as an identity tells of it; nothing where each is that of its robot, or is not told."""
    usual = [robot_named(name).rest_rad for name in models] or [DEFAULT.rest_rad] * len(robots)
    told = [tuple(each.get("rest_rad", rest)) for each, rest in zip(robots, usual, strict=True)]
    return () if told == usual else tuple(told)


def _shuts(store: "Store") -> tuple[tuple[int, ...], ...]:
    """Of each arm at how many changes of its gripper it is shut on nothing, in most demonstrations."""
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
    """Of every agent of a store. Raises ArgumentError for a robot that is not known here."""
    names = {robot.measured: robot.name for robot in known_robots()}
    found = [names.get(model.joints) for model in store.models]
    if None in found:
        titles = ", ".join(sorted({model.title for model in store.models if model.joints not in names}))
        known = ", ".join(robot.title for robot in known_robots())
        raise ArgumentError(f"{store.path} is of {titles}; policies learn to move what is known: {known}")
    return () if {*found} == {DEFAULT.name} else tuple(map(str, found))


class Memory:
    """What the grippers have been told so far: how often they changed, as one-hot, and how recently.

    A picture after the fingers closed looks much like the one before, and what comes next is not the same.
    Fingers that have shut on nothing and open again have changed nothing: such a miss is taken back, so that
    what comes next is once more what came next before it.
    """

    def __init__(self, agents: int) -> None:
        self.opened = np.ones(agents, dtype=bool)  # (N,) by the last command; so every episode begins
        self.changes = np.zeros(agents, dtype=int)  # (N,)
        self._since = np.full(agents, RECENT_STEPS)

    def told(self, grippers: Mapping[int, float], widths: Floats) -> None:
        """The commands of one control step, of those agents whose commands are known.

        `widths` (N,) is how far apart the fingers of each were measured before it, in m.
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
    """The memory (T, N, MEMORY) before each step of an episode with commands and widths in m, (T, N) each."""
    memory, rows = Memory(grippers.shape[1]), []
    for commands, apart in zip(grippers, widths, strict=True):
        rows.append(memory.vector)
        memory.told(dict(enumerate(commands, start=1)), apart)
    return np.array(rows, np.float32)


def changes(gripper: Floats, width: Floats) -> NDArray[np.int64]:
    """The steps in which a gripper changes for good, by its commands and widths in m, (T,) each."""
    found: list[int] = []
    for step in np.flatnonzero(np.diff(gripper > 0, prepend=True)):
        if gripper[step] > 0 and width[step] < EMPTY_M and found:
            found.pop()
        else:
            found.append(int(step))
    return np.array(found, np.int64)


def widths(qpos: Floats) -> Floats:
    """How far apart the fingers are, in m: measured joints (..., N, D) -> (..., N)."""
    return fingers_of(qpos).sum(axis=-1)


def proprioception(qpos: Floats) -> NDArray[np.float32]:
    """Measured joint positions (..., N, 9) -> (..., 8N): seven joints (rad) and the opening (m) an agent.

    Both fingers of the gripper keep the same width (paper, supplementary), so their sum says it all.
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
    """The context (..., C) of stream `row` of a view, where the bases (4, 4) of all arms stand so.

    From the measured joints of all agents (..., N, 9), world poses of objects (..., 4, 4) and what all
    grippers have done (..., N, M), see `Memory`; behind that what is told of their subgoals, which comes last
    in the context.
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
    if len(view.streams) > 1:  # one policy for several agents: which of them
        parts.append(np.broadcast_to(np.eye(len(view.streams))[row], (*qpos.shape[:-2], len(view.streams))))
    parts += [memory[..., agent - 1, MEMORY:] for agent in stream.agents]
    return np.concatenate(parts, axis=-1).astype(np.float32)


def footprint(world_from_base: Matrix) -> Matrix:
    """Where a base (4, 4) stands on the table, which is at z = 0 of the world."""
    below = world_from_base.copy()
    below[2, 3] = 0.0
    return below


def tcp_poses(spec: ObservationSpec, bases: Sequence[Matrix], stream: Stream, joints: Floats) -> Floats:
    """Where joints (..., n, 7) put the TCPs of the agents of a stream: (..., n, POSE), like its context."""
    return flat_pose(footprint_from_tcps(spec, bases, stream, joints))


def footprint_from_tcps(
    spec: ObservationSpec, bases: Sequence[Matrix], stream: Stream, joints: Floats
) -> NDArray[np.float64]:
    """The same as matrices (..., n, 4, 4)."""
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
    """Offsets (...) in m from a hand to what it may be near to, in [-1, 1], NEAR_M and farther off 1."""
    return offset_m.clip(-NEAR_M, NEAR_M) / NEAR_M


def world_from_tcp(
    spec: ObservationSpec, bases: Sequence[Matrix], agent: int, qpos: Floats
) -> NDArray[np.float64]:
    """(..., 4, 4) of an agent: bases (4, 4) and joints of all agents (..., N, 7 or more), in the world."""
    return bases[agent - 1] @ spec.robot(agent).tcp_pose(qpos[..., agent - 1, :ARM_JOINTS])


def flat_pose(poses: Floats) -> Floats:
    """(..., 4, 4) -> (..., POSE)."""
    axes = poses[..., :3, :2].swapaxes(-1, -2).reshape(*poses.shape[:-2], 6)
    return np.concatenate([poses[..., :3, 3], axes], axis=-1)


def of_agent(context: Tensor, row: int) -> tuple[Tensor, Tensor]:
    """Of a context (..., C): the pose of the TCP of the own agent `row` (..., POSE), its changes, one-hot."""
    first = row * (POSE + MEMORY)
    return context[..., first : first + POSE], context[..., first + POSE : first + POSE + CHANGES + 1]

"""From a proposal to one trajectory for each agent (paper: unconstrained trajectory generation)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from rf_exp.coordination import Demands
from rf_exp.datagen.motion.queues import Lockstep, Order, Queues
from rf_exp.datagen.motion.reach import Reach
from rf_exp.datagen.motion.request import Request
from rf_exp.datagen.motion.state import Blocked, State, Unreachable
from rf_exp.datagen.motion.timing import parameterise
from rf_exp.datagen.motion.verbs import Motion, leave, lift_line, plan
from rf_exp.datagen.yielding import Yielding
from rf_exp.findings import Cause, Finding
from rf_exp.statements import Proposal
from rf_exp.tasks import Task
from rf_exp.transforms import inverse
from rf_exp.types import (
    GRIPPER_CLOSED,
    GRIPPER_OPEN,
    JointLimits,
    Scene,
    Segment,
    Subgoal,
    Trajectory,
)


def present_state(task: Task, scene: Scene) -> State:
    """What planning starts from: the measured scene."""
    held = {
        agent: (name, inverse(task.arms[agent].tcp(scene.qpos[agent - 1])) @ scene.poses[name])
        for agent, name in zip(task.agents, scene.held, strict=True)
        if name is not None
    }
    return State(
        qpos={agent: task.arms[agent].joints(scene.qpos[agent - 1]).copy() for agent in task.agents},
        gripper={agent: GRIPPER_CLOSED if agent in held else GRIPPER_OPEN for agent in task.agents},
        held=held,
        poses=dict(scene.poses),
        places=task.places(scene),
    )


@dataclass(frozen=True)
class Handover:
    """A thing is met where another agent has left it, so that comes later, whether it was asked for or not.

    Knots are counted along the trajectories of both.
    """

    giver: int
    left_at: int  # knot at which the giver is done with it
    taker: int
    begins_at: int  # knot from which on the taker goes for it

    def demand(self, demands: Demands) -> None:
        left = demands.trajectory(self.giver).knots[self.left_at]
        demands.before(self.giver, left, self.taker, demands.trajectory(self.taker).knots[self.begins_at])


@dataclass(frozen=True)
class Motions:
    """What becomes of a proposal before anything is timed."""

    trajectories: tuple[Trajectory, ...]  # one an agent, idle ones empty
    state: State  # that they should end in
    subgoals: tuple[Subgoal, ...]  # each begins with things where those before it leave them
    handovers: tuple[Handover, ...]


def plan_motion(
    task: Task,
    proposal: Proposal,
    scene: Scene,
    *,
    blocked: Blocked,
    limits: JointLimits,
    lockstep: Lockstep,
    order: Order = (),
    yielding: Yielding,
    rng: np.random.Generator,
) -> Motions:
    """Motions that carry out a proposal.

    Subgoals named in `lockstep` are timed as one motion of all their agents. What comes later in
    `order` starts from where the earlier leaves the objects. Arms yield where a way is free. Raises
    Unreachable.
    """
    begin, planned = present_state(task, scene), list[Subgoal]()
    ask = partial(Request, task, Reach(task.arms, limits, blocked, rng))
    made = _Made(task, begin)
    for agent in yielding.first:
        made.add(_yield(ask(Subgoal(agent, "aside")), made.state))
    queues = Queues(proposal, lockstep, order)
    while subgoals := queues.next():
        try:
            motion = _motion_of(subgoals, queues, ask, made.state)
        except Unreachable as error:
            queues.stuck(subgoals, error)
            continue
        queues.planned(subgoals, {each.attached for each in motion[0] if each.attached is not None})
        planned += subgoals
        made.add(motion, subgoals)
        for agent in (each.agent for each in subgoals if each.agent in yielding.once_done):
            last = made.segments[agent][-1:]
            if queues.done(agent) and last and last[0].primitive == "retreat":
                made.add(_yield(ask(Subgoal(agent, yielding.to)), made.state))
    trajectories = (
        Trajectory(agent, begin.qpos[agent], begin.gripper[agent], tuple(made.segments[agent]))
        for agent in task.agents
    )
    return Motions(tuple(trajectories), made.state, tuple(planned), tuple(made.handovers))


def _motion_of(
    subgoals: Sequence[Subgoal], queues: Queues, ask: Callable[..., Request], state: State
) -> Motion:
    """Of one subgoal, or of those that are one motion."""
    if len(subgoals) > 1:
        return _joint_lift([ask(each) for each in subgoals], state)
    (subgoal,) = subgoals
    return plan(ask(subgoal, queues.following(subgoal.agent), queues.of_others(subgoal.agent)), state)


class _Made:
    """The motions so far, what they lead to, and who has left what where."""

    def __init__(self, task: Task, state: State) -> None:
        self.state, self.handovers = state, list[Handover]()
        self.segments: dict[int, list[Segment]] = {agent: [] for agent in task.agents}  # but for empty ones
        self._left: dict[str, tuple[int, int]] = {}  # thing -> who moved it last, and the knot after that

    def add(self, motion: Motion, subgoals: Sequence[Subgoal] = ()) -> None:
        """Adds a motion, of these subgoals."""
        for subgoal in subgoals:
            agent = subgoal.agent
            held, _ = self.state.held.get(agent, (None, None))
            for name in sorted(subgoal.names - {held}):
                giver, left_at = self._left.get(name, (agent, 0))
                if giver != agent:
                    self.handovers.append(Handover(giver, left_at, agent, len(self.segments[agent])))
        segments, self.state = motion
        for each in filter(len, segments):
            self.segments[each.agent].append(each)
        for each in segments:
            mine = [name for name, (agent, _) in self._left.items() if agent == each.agent]
            for name in {each.attached, *mine} & each.subgoal.names:
                self._left[name] = each.agent, len(self.segments[each.agent])


def _yield(request: Request, state: State) -> Motion:
    """To a posture that is in nobody's way, where a way is free; otherwise nowhere."""
    try:
        return leave(request, state)
    except Unreachable:
        return (), state


def _joint_lift(requests: Sequence[Request], state: State) -> Motion:
    """Lifts one object with several arms: the lines share one time scale, so the object stays level."""
    lines = [lift_line(request, state) for request in requests]
    first = requests[0]
    if len({len(line) for line in lines}) > 1:
        agents = tuple(request.agent for request in requests)
        raise Unreachable(Cause.INTERACTION, Finding.UNEVEN_LIFT, agents, object=first.subgoal.object)
    timed = parameterise(np.hstack(lines), first.reach.limits)  # (T, joints of all of them)
    ends = np.cumsum([line.shape[1] for line in lines])[:-1]
    verb, lifted = first.subgoal.verb, []
    for request, points in zip(requests, np.split(timed, ends, axis=1), strict=True):
        each, state = request.segment(verb, points, state, joined=f"{verb} {first.subgoal.object}")
        lifted.append(each)
    return tuple(lifted), state

"""Motion planning of a proposal: one trajectory for each agent (paper: unconstrained trajectory generation).

A proposal is a set of queues, one per agent; the order in which it lists agents has no meaning. A queue waits
while a subgoal that must end before its next one has not been planned, and while an object that another queue
may still move is in its way or out of its reach.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from rf_exp.coordination import Demands
from rf_exp.datagen.motion.reach import Reach
from rf_exp.datagen.motion.request import Request
from rf_exp.datagen.motion.state import State, Unreachable
from rf_exp.datagen.motion.timing import parameterise
from rf_exp.datagen.motion.verbs import Motion, leave, lift_line, plan
from rf_exp.datagen.yielding import Yielding
from rf_exp.findings import Cause, Finding, agent_name
from rf_exp.statements import Proposal
from rf_exp.tasks import Task
from rf_exp.transforms import inverse
from rf_exp.types import GRIPPER_CLOSED, GRIPPER_OPEN, Scene, Segment, Subgoal, Trajectory

Lockstep = Collection[tuple[frozenset[int], str, str]]  # agents, verb, object: one joint motion
Part = tuple[int, str | None, str | None]  # agent, verb, object; without a verb all subgoals of the agent
Order = Collection[tuple[Part, Part]]  # the first ends before the second begins


@dataclass(frozen=True)
class _Stuck:
    """Reason why the next subgoal of an agent has no motion at present."""

    error: Unreachable
    by: frozenset[str] | None  # objects, one of which has to move first; None: any motion may help
    moved: bool = False  # whether that has happened


def in_turn(proposal: Proposal, order: Order) -> Proposal:
    """The proposal in a canonical order, the same for every order in which it may list its agents.

    First come agents that wait for no other remaining agent, of several the one with the lowest number, so
    that objects are already where later agents will meet them.
    """
    left, listed = sorted({subgoal.agent for subgoal in proposal.subgoals}), []
    while left:
        waiting = {then[0] for first, then in order if first[0] in left and first[0] != then[0]}
        agent = next((each for each in left if each not in waiting), left[0])
        left.remove(agent)
        listed += proposal.of(agent)
    return replace(proposal, subgoals=tuple(listed))


class Queues:
    """Subgoals still to be planned. Of the agents that can go on, the last one does, else the first listed.

    So an agent that has put an object down goes away before others come to the same place.
    """

    def __init__(self, proposal: Proposal, lockstep: Lockstep, order: Order) -> None:
        agents = dict.fromkeys(subgoal.agent for subgoal in proposal.subgoals)
        self.left = {agent: list(proposal.of(agent)) for agent in agents}  # agent -> remaining subgoals
        self._lockstep, self._order = lockstep, order
        self._stuck: dict[int, _Stuck] = {}
        self._last: int | None = None  # agent of the last subgoal, unless joint

    def next(self) -> Sequence[Subgoal]:
        """The next subgoal to plan, or those of several agents that are one motion; empty at the end.

        Raises Unreachable where no agent can go on, with the reason of the first that is stuck.
        """
        fronts = {agent: queue[0] for agent, queue in self.left.items() if queue}
        if not fronts:
            return ()
        ready = [each for each in fronts.values() if each.agent not in self._stuck and not self._waits(each)]
        if alone := [each for each in ready if not self._group(each)]:
            return [next((each for each in alone if each.agent == self._last), alone[0])]
        if together := self._together(ready):
            return together
        still = {agent: each for agent, each in self._stuck.items() if not each.moved}
        if len(still) < len(self._stuck):
            self._stuck = still
            return self.next()
        for each in still.values():
            raise each.error
        circle = tuple(f"{agent_name(agent)}: {front.text}" for agent, front in fronts.items())
        raise Unreachable(Cause.TIME, Finding.CIRCLE, tuple(fronts), subgoals=circle)

    def planned(self, subgoals: Sequence[Subgoal], moved: Collection[str]) -> None:
        """Removes subgoals that have been planned; their motion moves the objects `moved`."""
        for each in subgoals:
            self.left[each.agent].pop(0)
        self._last = subgoals[0].agent if len(subgoals) == 1 else None
        for agent, each in self._stuck.items():
            if each.by is None or each.by.intersection(moved):
                self._stuck[agent] = replace(each, moved=True)

    def stuck(self, subgoals: Sequence[Subgoal], error: Unreachable) -> None:
        """Marks subgoals that have no motion until others go on. Raises `error` where that cannot help."""
        if error.cause is Cause.REACH:
            by = frozenset[str]().union(*(each.names for each in subgoals))
        elif error.cause is Cause.SPACE:
            alone = "obstacles" in error.facts and error.agents[1:] == ()
            by = frozenset(error.facts["obstacles"]) if alone else None
        else:
            raise error
        self._stuck |= {each.agent: _Stuck(error, by) for each in subgoals}

    def _waits(self, subgoal: Subgoal) -> bool:
        """Whether a subgoal that must end before this one has not been planned yet."""
        return any(
            _is_of(then, subgoal) and any(map(partial(_is_of, first), self.left.get(first[0], ())))
            for first, then in self._order
        )

    def _group(self, subgoal: Subgoal) -> frozenset[int]:
        """The agents that carry out this subgoal as one motion; empty where it is not a joint one."""
        for agents, verb, name in self._lockstep:
            if subgoal.agent in agents and (subgoal.verb, subgoal.object) == (verb, name) and verb == "lift":
                return agents
        return frozenset()

    def _together(self, ready: Sequence[Subgoal]) -> Sequence[Subgoal]:
        """The subgoals of a joint motion that all its agents are ready for, if any."""
        for first in ready:
            agents, what = self._group(first), (first.verb, first.object)
            members = [each for each in ready if each.agent in agents and what == (each.verb, each.object)]
            if {each.agent for each in members} == agents:
                return members
        return ()


def _is_of(part: Part, subgoal: Subgoal) -> bool:
    agent, verb, name = part
    return subgoal.agent == agent and (verb is None or (subgoal.verb, subgoal.object) == (verb, name))


def present_state(task: Task, scene: Scene) -> State:
    """The state from which planning starts: the measured scene."""
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
    """An object that one agent meets where another has left it: an order, whether demanded or not."""

    giver: int
    left_at: int  # knot at which the giver is done with it
    taker: int
    begins_at: int  # knot at which the taker sets out for it

    def demand(self, demands: Demands) -> None:
        left = demands.trajectory(self.giver).knots[self.left_at]
        demands.before(self.giver, left, self.taker, demands.trajectory(self.taker).knots[self.begins_at])


@dataclass(frozen=True)
class Motions:
    """The motions of a proposal, before they are scheduled."""

    trajectories: tuple[Trajectory, ...]  # one per agent, empty for idle ones
    state: State  # predicted at their end
    subgoals: tuple[Subgoal, ...]  # in planning order: each begins with objects as earlier ones leave them
    handovers: tuple[Handover, ...]


def plan_motion(
    task: Task,
    proposal: Proposal,
    scene: Scene,
    reach: Reach,
    *,
    lockstep: Lockstep,
    order: Order = (),
    yielding: Yielding,
) -> Motions:
    """Motions that carry out a proposal. Raises Unreachable.

    Subgoals in `lockstep` are timed as one motion of all their agents. A later subgoal in `order` starts with
    the objects where the earlier one leaves them. Arms yield where a path is free.
    """
    begin, planned = present_state(task, scene), list[Subgoal]()
    ask, made = partial(Request, task, reach), _Made(task, begin)
    for agent in yielding.first:
        made.add(_yield(ask(Subgoal(agent, "aside")), made.state))
    queues = Queues(proposal, lockstep, order)
    while subgoals := queues.next():
        try:
            if len(subgoals) > 1:
                motion = _joint_lift([ask(each) for each in subgoals], made.state)
            else:
                agent = subgoals[0].agent
                others = [each for other, queue in queues.left.items() if other != agent for each in queue]
                motion = plan(ask(subgoals[0], queues.left[agent][1:], others), made.state)
        except Unreachable as error:
            queues.stuck(subgoals, error)
            continue
        queues.planned(subgoals, {each.attached for each in motion[0] if each.attached is not None})
        planned += subgoals
        made.add(motion, subgoals)
        for agent in (each.agent for each in subgoals if each.agent in yielding.once_done):
            last = made.segments[agent][-1:]
            if not queues.left[agent] and last and last[0].primitive == "retreat":
                made.add(_yield(ask(Subgoal(agent, yielding.to)), made.state))
    trajectories = (
        Trajectory(agent, begin.qpos[agent], begin.gripper[agent], tuple(made.segments[agent]))
        for agent in task.agents
    )
    return Motions(tuple(trajectories), made.state, tuple(planned), tuple(made.handovers))


class _Made:
    """The motions so far, the state they lead to, and which agent has left which object where."""

    def __init__(self, task: Task, state: State) -> None:
        self.state, self.handovers = state, list[Handover]()
        self.segments: dict[int, list[Segment]] = {agent: [] for agent in task.agents}  # without empty ones
        self._left: dict[str, tuple[int, int]] = {}  # object -> agent that moved it last, knot after that

    def add(self, motion: Motion, subgoals: Sequence[Subgoal] = ()) -> None:
        """Adds a motion of these subgoals."""
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
    """Moves to a posture out of the way, if a path is free; otherwise stays."""
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

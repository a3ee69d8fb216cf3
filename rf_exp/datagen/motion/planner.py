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
StepKey = tuple[int, str | None, str | None]  # agent, verb, object; without a verb all subgoals of the agent
Order = Collection[tuple[StepKey, StepKey]]  # the first ends before the second begins


@dataclass(frozen=True)
class _Stuck:
    """Reason why the next subgoal of an agent has no motion at present."""

    error: Unreachable
    blockers: frozenset[str] | None  # objects, one of which has to move first; None: any motion may help
    has_moved: bool = False  # whether one of them has


def canonical_order(proposal: Proposal, order: Order) -> Proposal:
    """The proposal in a canonical order, the same for every order in which it may list its agents.

    First come agents that wait for no other remaining agent, of several the one with the lowest number, so
    that objects are already where later agents will meet them.
    """
    remaining, subgoals = sorted({subgoal.agent for subgoal in proposal.subgoals}), []
    while remaining:
        waiting = {then[0] for first, then in order if first[0] in remaining and first[0] != then[0]}
        agent = next((each for each in remaining if each not in waiting), remaining[0])
        remaining.remove(agent)
        subgoals += proposal.subgoals_of(agent)
    return replace(proposal, subgoals=tuple(subgoals))


class Queues:
    """Subgoals still to be planned. Of the agents that can go on, the last one does, else the first listed.

    So an agent that has put an object down goes away before others come to the same place.
    """

    def __init__(self, proposal: Proposal, lockstep: Lockstep, order: Order) -> None:
        agents = dict.fromkeys(subgoal.agent for subgoal in proposal.subgoals)
        # agent -> remaining subgoals
        self.remaining = {agent: list(proposal.subgoals_of(agent)) for agent in agents}
        self._lockstep, self._order = lockstep, order
        self._stuck: dict[int, _Stuck] = {}
        self._last: int | None = None  # agent of the last subgoal, unless joint

    def next(self) -> Sequence[Subgoal]:
        """The next subgoal to plan, or those of several agents that are one motion; empty at the end.

        Raises Unreachable where no agent can go on, with the reason of the first that is stuck.
        """
        fronts = {agent: queue[0] for agent, queue in self.remaining.items() if queue}
        if not fronts:
            return ()
        unblocked = (subgoal for agent, subgoal in fronts.items() if agent not in self._stuck)
        ready = [subgoal for subgoal in unblocked if not self._is_waiting(subgoal)]
        if alone := [subgoal for subgoal in ready if not self._joint_agents(subgoal)]:
            return [next((subgoal for subgoal in alone if subgoal.agent == self._last), alone[0])]
        if together := self._ready_joint_subgoals(ready):
            return together
        still_stuck = {agent: each for agent, each in self._stuck.items() if not each.has_moved}
        if len(still_stuck) < len(self._stuck):
            self._stuck = still_stuck
            return self.next()
        for each in still_stuck.values():
            raise each.error
        cycle = tuple(f"{agent_name(agent)}: {front.text}" for agent, front in fronts.items())
        raise Unreachable(Cause.TIME, Finding.CIRCLE, tuple(fronts), subgoals=cycle)

    def mark_planned(self, subgoals: Sequence[Subgoal], moved: Collection[str]) -> None:
        """Removes subgoals that have been planned; their motion moves the objects `moved`."""
        for subgoal in subgoals:
            self.remaining[subgoal.agent].pop(0)
        self._last = subgoals[0].agent if len(subgoals) == 1 else None
        for agent, each in self._stuck.items():
            if each.blockers is None or each.blockers.intersection(moved):
                self._stuck[agent] = replace(each, has_moved=True)

    def mark_stuck(self, subgoals: Sequence[Subgoal], error: Unreachable) -> None:
        """Marks subgoals that have no motion until others go on. Raises `error` where that cannot help."""
        if error.cause is Cause.REACH:
            blockers = frozenset[str]().union(*(subgoal.names for subgoal in subgoals))
        elif error.cause is Cause.SPACE:
            only_objects = "obstacles" in error.facts and error.agents[1:] == ()
            blockers = frozenset(error.facts["obstacles"]) if only_objects else None
        else:
            raise error
        self._stuck |= {subgoal.agent: _Stuck(error, blockers) for subgoal in subgoals}

    def _is_waiting(self, subgoal: Subgoal) -> bool:
        """Whether a subgoal that must end before this one has not been planned yet."""
        return any(
            _matches(then, subgoal) and any(map(partial(_matches, first), self.remaining.get(first[0], ())))
            for first, then in self._order
        )

    def _joint_agents(self, subgoal: Subgoal) -> frozenset[int]:
        """The agents that carry out this subgoal as one motion; empty where it is not a joint one."""
        for agents, verb, name in self._lockstep:
            if subgoal.agent in agents and (subgoal.verb, subgoal.object) == (verb, name) and verb == "lift":
                return agents
        return frozenset()

    def _ready_joint_subgoals(self, ready: Sequence[Subgoal]) -> Sequence[Subgoal]:
        """The subgoals of a joint motion that all its agents are ready for, if any."""
        for first in ready:
            agents, what = self._joint_agents(first), (first.verb, first.object)
            members = [each for each in ready if each.agent in agents and what == (each.verb, each.object)]
            if {each.agent for each in members} == agents:
                return members
        return ()


def _matches(part: StepKey, subgoal: Subgoal) -> bool:
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
    request_for, motions = partial(Request, task, reach), _PlannedMotions(task, begin)
    for agent in yielding.first:
        motions.add(_yield_motion(request_for(Subgoal(agent, "aside")), motions.state))
    queues = Queues(proposal, lockstep, order)
    while subgoals := queues.next():
        try:
            if len(subgoals) > 1:
                motion = _joint_lift([request_for(each) for each in subgoals], motions.state)
            else:
                agent = subgoals[0].agent
                queues_of_others = (queue for other, queue in queues.remaining.items() if other != agent)
                others = [subgoal for queue in queues_of_others for subgoal in queue]
                motion = plan(request_for(subgoals[0], queues.remaining[agent][1:], others), motions.state)
        except Unreachable as error:
            queues.mark_stuck(subgoals, error)
            continue
        queues.mark_planned(subgoals, {each.attached for each in motion[0] if each.attached is not None})
        planned += subgoals
        motions.add(motion, subgoals)
        for agent in (each.agent for each in subgoals if each.agent in yielding.once_done):
            last = motions.segments[agent][-1:]
            if not queues.remaining[agent] and last and last[0].primitive == "retreat":
                motions.add(_yield_motion(request_for(Subgoal(agent, yielding.posture)), motions.state))
    trajectories = (
        Trajectory(agent, begin.qpos[agent], begin.gripper[agent], tuple(motions.segments[agent]))
        for agent in task.agents
    )
    return Motions(tuple(trajectories), motions.state, tuple(planned), tuple(motions.handovers))


class _PlannedMotions:
    """The motions so far, the state they lead to, and which agent has left which object where."""

    def __init__(self, task: Task, state: State) -> None:
        self.state, self.handovers = state, list[Handover]()
        self.segments: dict[int, list[Segment]] = {agent: [] for agent in task.agents}  # without empty ones
        self._left_by: dict[str, tuple[int, int]] = {}  # object -> agent that moved it last, knot after that

    def add(self, motion: Motion, subgoals: Sequence[Subgoal] = ()) -> None:
        """Adds a motion of these subgoals."""
        for subgoal in subgoals:
            agent = subgoal.agent
            held, _ = self.state.held.get(agent, (None, None))
            for name in sorted(subgoal.names - {held}):
                giver, left_at = self._left_by.get(name, (agent, 0))
                if giver != agent:
                    self.handovers.append(Handover(giver, left_at, agent, len(self.segments[agent])))
        segments, self.state = motion
        for segment in filter(len, segments):
            self.segments[segment.agent].append(segment)
        for segment in segments:
            own_objects = [name for name, (agent, _) in self._left_by.items() if agent == segment.agent]
            for name in {segment.attached, *own_objects} & segment.subgoal.names:
                self._left_by[name] = segment.agent, len(self.segments[segment.agent])


def _yield_motion(request: Request, state: State) -> Motion:
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
        segment, state = request.segment(verb, points, state, joined=f"{verb} {first.subgoal.object}")
        lifted.append(segment)
    return tuple(lifted), state

"""From a proposal to one trajectory for each agent (paper: unconstrained trajectory generation)."""

from collections.abc import Collection, Sequence
from functools import partial

import numpy as np

from rf_exp.datagen.motion.reach import Reach
from rf_exp.datagen.motion.request import Request
from rf_exp.datagen.motion.state import Blocked, State, Unreachable
from rf_exp.datagen.motion.timing import parameterise
from rf_exp.datagen.motion.verbs import Motion, leave, lift_line, plan
from rf_exp.datagen.yielding import Yielding
from rf_exp.findings import Cause, Finding, agent_name
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

Lockstep = Collection[tuple[frozenset[int], str, str]]  # agents, verb, object: done as one motion
Part = tuple[int, str | None, str | None]  # agent, verb, object; without a verb all that the agent does
Order = Collection[tuple[Part, Part]]  # the first is over before the second begins


def present_state(task: Task, scene: Scene) -> State:
    """What planning starts from: the measured scene."""
    held = {
        agent: (name, inverse(task.arms[agent].tcp(scene.qpos[agent - 1])) @ scene.poses[name])
        for agent, name in zip(task.agents, scene.held, strict=True)
        if name is not None
    }
    return State(
        qpos={agent: scene.qpos[agent - 1, :7].copy() for agent in task.agents},
        gripper={agent: GRIPPER_CLOSED if agent in held else GRIPPER_OPEN for agent in task.agents},
        held=held,
        poses=dict(scene.poses),
        places=task.places(scene),
    )


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
) -> tuple[tuple[Trajectory, ...], State]:
    """One trajectory for each agent of the task, idle ones empty, and the state they should end in.

    Subgoals named in `lockstep` are timed as one motion of all their agents. What comes later in
    `order` starts from where the earlier leaves the objects. Arms yield where a way is free. Raises
    Unreachable.
    """
    state = begin = present_state(task, scene)
    ask = partial(Request, task, Reach(task.arms, limits, blocked, rng))
    segments: dict[int, list[Segment]] = {agent: [] for agent in task.agents}
    add = partial(_add, segments)

    for agent in yielding.first:
        state = add(_yield(ask(Subgoal(agent, "aside")), state))
    waiting = {agent: list(proposal.of(agent)) for agent in dict.fromkeys(s.agent for s in proposal.subgoals)}
    while any(waiting.values()):
        ready = [queue for queue in waiting.values() if queue and not _waits(queue[0], waiting, order)]
        alone = next((queue for queue in ready if _group(queue[0], lockstep) is None), None)
        if alone is None:
            together = _next_group(ready, lockstep, waiting)
            state = add(_joint_lift([ask(subgoal) for subgoal in together], state))
            continue
        subgoal = alone.pop(0)
        of_others = [each for queue in waiting.values() if queue is not alone for each in queue]
        state = add(plan(ask(subgoal, alone, of_others), state))
        last = segments[subgoal.agent][-1:]
        if not alone and subgoal.agent in yielding.once_done and last and last[0].primitive == "retreat":
            state = add(_yield(ask(Subgoal(subgoal.agent, yielding.to)), state))
    return tuple(
        Trajectory(agent, begin.qpos[agent], begin.gripper[agent], tuple(filter(len, segments[agent])))
        for agent in task.agents
    ), state


def _add(segments: dict[int, list[Segment]], motion: Motion) -> State:
    """The state after a motion, whose segments are added to those of their agents."""
    for each in motion[0]:
        segments[each.agent].append(each)
    return motion[1]


def _group(subgoal: Subgoal, lockstep: Lockstep) -> frozenset[int] | None:
    """The agents that carry out this subgoal as one motion, if it is such a one."""
    for agents, verb, name in lockstep:
        if subgoal.agent in agents and (subgoal.verb, subgoal.object) == (verb, name) and verb == "lift":
            return agents
    return None


def _yield(request: Request, state: State) -> Motion:
    """To a posture that is in nobody's way, where a way is free; otherwise nowhere."""
    try:
        return leave(request, state)
    except Unreachable:
        return (), state


def _waits(subgoal: Subgoal, waiting: dict[int, list[Subgoal]], order: Order) -> bool:
    """Whether something that must be over before this subgoal has not been planned yet."""

    def part_of(each: Subgoal, part: Part) -> bool:
        agent, verb, name = part
        return each.agent == agent and (verb is None or (each.verb, each.object) == (verb, name))

    return any(
        part_of(subgoal, then) and any(part_of(each, first) for each in waiting.get(first[0], ()))
        for first, then in order
    )


def _next_group(
    ready: list[list[Subgoal]], lockstep: Lockstep, waiting: dict[int, list[Subgoal]]
) -> list[Subgoal]:
    """The joint subgoal that all its agents have come to; taken off their lists."""
    fronts = [queue[0] for queue in ready]
    for first in fronts:
        agents = _group(first, lockstep) or frozenset()
        members = [
            s for s in fronts if s.agent in agents and (s.verb, s.object) == (first.verb, first.object)
        ]
        if {s.agent for s in members} == agents:
            for member in members:
                waiting[member.agent].pop(0)
            return members
    stuck = {agent: f"{agent_name(agent)}: {queue[0].text}" for agent, queue in waiting.items() if queue}
    raise Unreachable(Cause.TIME, Finding.CIRCLE, tuple(stuck), subgoals=tuple(stuck.values()))


def _joint_lift(requests: Sequence[Request], state: State) -> Motion:
    """Lifts one object with several arms: the lines share one time scale, so the object stays level."""
    lines = [lift_line(request, state) for request in requests]
    first = requests[0]
    if len({len(line) for line in lines}) > 1:
        agents = tuple(request.agent for request in requests)
        raise Unreachable(Cause.INTERACTION, Finding.UNEVEN_LIFT, agents, object=first.subgoal.object)
    timed = parameterise(np.hstack(lines), first.reach.limits)  # (T, 7 * agents)
    verb, lifted = first.subgoal.verb, []
    for request, points in zip(requests, np.split(timed, len(requests), axis=1), strict=True):
        each, state = request.segment(verb, points, state, joined=f"{verb} {first.subgoal.object}")
        lifted.append(each)
    return tuple(lifted), state

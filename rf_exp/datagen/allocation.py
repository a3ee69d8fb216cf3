"""Allocation of open jobs to agents, by reach, duration and the load of all agents.

A plan may leave open which agent does a job: its subgoals are those of `ANYBODY`. A job is a run of subgoals
with one object, from the grasp on, or one press. The duration of a job for an agent is estimated as in the
look-ahead of planning, from the agent's present state and without obstacles; `assign` chooses.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import groupby
from typing import Any

import numpy as np

from rf_exp.coordination import assign
from rf_exp.datagen.brain import BadAnswer
from rf_exp.datagen.motion.paths import Search
from rf_exp.datagen.motion.planner import present_state
from rf_exp.datagen.motion.reach import Reach
from rf_exp.datagen.motion.request import Request, destinations
from rf_exp.datagen.motion.state import State, Unreachable
from rf_exp.datagen.motion.verbs import estimated_s
from rf_exp.findings import Cause, Finding
from rf_exp.statements import VERBS, Before, Proposal, Statement, Step
from rf_exp.tasks import Task
from rf_exp.types import ANYBODY, JointLimits, Scene, Subgoal

Job = Sequence[Subgoal]  # of one agent, with one object


def allocated(proposal: Proposal, task: Task, scene: Scene, limits: JointLimits) -> Proposal:
    """The proposal with an agent in place of every `ANYBODY`; unchanged where there is none.

    Each agent does its jobs in the order in which they are listed. Raises Unreachable for a job that no agent
    can do, BadAnswer for a job or constraint that cannot be left open.
    """
    if all(subgoal.agent != ANYBODY for subgoal in proposal.subgoals):
        for each in proposal.constraints:
            if ANYBODY in each.agents:
                told = f"constraint {each.sentence!r} is about anybody, but the plan says who does what"
                raise BadAnswer(f"{told}; name the agent")
        return proposal
    # Without obstacles and path search.
    reach = Reach(task.arms, limits, lambda *_, **__: None, Search(np.random.default_rng(0)))
    state = present_state(task, scene)
    jobs = list(_jobs(proposal.subgoals))
    takes_s = np.full((len(jobs), len(task.agents)), np.inf)
    poses = dict(scene.poses)  # as earlier jobs leave them
    for job, row in zip(jobs, takes_s, strict=True):
        now, is_open = replace(state, poses=poses), job[0].agent == ANYBODY
        for agent in task.agents if is_open else (job[0].agent,):
            row[agent - 1] = _takes_s(task, reach, [replace(each, agent=agent) for each in job], now)
        if is_open and not np.isfinite(row).any():
            what = (job[0].text,) if len(job) == 1 else (f"{job[0].text} and {job[-1].text}",)
            raise Unreachable(Cause.REACH, Finding.NOBODY, task.agents, subgoals=what)
        for each in job:
            if each.verb == "place" and each.object is not None:  # its rotation there is not known yet
                goals = destinations(task, replace(each, agent=1), replace(scene, poses=poses))
                poses[each.object] = goals[0]
                break
    open_ = [number for number, job in enumerate(jobs) if job[0].agent == ANYBODY]
    told = np.nan_to_num(np.delete(takes_s, open_, axis=0), posinf=0.0).sum(axis=0)
    assigned = assign(takes_s[open_], told)
    assert assigned is not None  # some agent can do each of them
    chosen = dict(zip(open_, assigned.agents, strict=True))
    subgoals = tuple(
        replace(each, agent=chosen[number] + 1) if number in chosen else each
        for number, job in enumerate(jobs)
        for each in job
    )
    return Proposal(subgoals, tuple(_stated(proposal.constraints, subgoals)))


def _jobs(subgoals: Sequence[Subgoal]) -> Iterator[Job]:
    """Splits subgoals into jobs. Raises BadAnswer where one of `ANYBODY` begins with another verb."""
    for (agent, name), run in groupby(subgoals, key=lambda each: (each.agent, each.object)):
        job: list[Subgoal] = []
        for each in run:
            meets = VERBS[each.verb].meets in ("grasp", "press")
            if job and meets:
                yield job
                job = []
            if agent == ANYBODY and not job and not meets:
                raise BadAnswer(
                    f"anybody cannot {each.text}: what anybody may do begins with grasp or press; say which "
                    f"agent goes on{f' with {name}' if name else ''}"
                )
            job.append(each)
        yield job


def _takes_s(task: Task, reach: Reach, job: Job, state: State) -> float:
    """Estimated duration in s of a job for its agent; 0 where unknown, infinite where it cannot do it."""
    if VERBS[job[0].verb].meets not in ("grasp", "press"):
        return 0.0
    about = frozenset({*task.objects} & {job[0].object})
    return estimated_s(Request(task, reach, job[0], job[1:]), replace(state, targets=about))


def _stated(constraints: Sequence[Statement], subgoals: Sequence[Subgoal]) -> Iterator[Statement]:
    """The constraints with the chosen agents, without orders that have become those of a single agent."""
    for each in constraints:
        known = _known(each, subgoals, each.sentence)
        if known == each or not isinstance(known, Before) or len(set(known.agents)) == len(known.agents):
            yield known


def _known(part: Any, subgoals: Sequence[Subgoal], sentence: str) -> Any:
    """A statement, or a step, with `ANYBODY` replaced by the one agent that handles its object."""
    changes: dict[str, Any] = {
        key: _known(value, subgoals, sentence) for key, value in vars(part).items() if isinstance(value, Step)
    }
    if getattr(part, "agent", None) == ANYBODY:
        name, verb = getattr(part, "object", None), getattr(part, "verb", None)
        agents = {each.agent for each in subgoals if each.object == name and verb in (None, each.verb)}
        if len(agents) != 1 or name is None:
            raise BadAnswer(
                f"constraint {sentence!r}: it is about anybody, and {'more than one' if agents else 'no'} "
                f"agent of this plan has to do with {name or 'what it says'}; say which agent"
            )
        changes["agent"] = agents.pop()
    return replace(part, **changes) if changes else part

"""Allocation of open jobs to agents, by reach, duration and the load of all agents.

A plan may leave open which agent does a job: its subgoals are those of `ANY_AGENT`. A job is a run of
subgoals with one object, from the grasp on, or one press. The duration of a job for an agent is estimated as
in the look-ahead of planning, from the agent's present state and without obstacles; `assign` chooses.
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
from rf_exp.types import ANY_AGENT, JointLimits, Scene, Subgoal

Job = Sequence[Subgoal]  # of one agent, with one object


def allocate_jobs(proposal: Proposal, task: Task, scene: Scene, limits: JointLimits) -> Proposal:
    """The proposal with an agent in place of every `ANY_AGENT`; unchanged where there is none.

    Each agent does its jobs in the order in which they are listed. Raises Unreachable for a job that no agent
    can do, BadAnswer for a job or constraint that cannot be left open.
    """
    if all(subgoal.agent != ANY_AGENT for subgoal in proposal.subgoals):
        for constraint in proposal.constraints:
            if ANY_AGENT in constraint.agents:
                sentence = constraint.sentence
                message = f"constraint {sentence!r} is about anybody, but the plan says who does what"
                raise BadAnswer(f"{message}; name the agent")
        return proposal
    # Without obstacles and path search.
    reach = Reach(task.arms, limits, lambda *_, **__: None, Search(np.random.default_rng(0)))
    state = present_state(task, scene)
    jobs = list(_jobs(proposal.subgoals))
    durations_s = np.full((len(jobs), len(task.agents)), np.inf)
    poses = dict(scene.poses)  # as earlier jobs leave them
    for job, row in zip(jobs, durations_s, strict=True):
        current, is_open = replace(state, poses=poses), job[0].agent == ANY_AGENT
        for agent in task.agents if is_open else (job[0].agent,):
            own_job = [replace(subgoal, agent=agent) for subgoal in job]
            row[agent - 1] = _job_duration_s(task, reach, own_job, current)
        if is_open and not np.isfinite(row).any():
            subgoal_texts = (job[0].text,) if len(job) == 1 else (f"{job[0].text} and {job[-1].text}",)
            raise Unreachable(Cause.REACH, Finding.NOBODY, task.agents, subgoals=subgoal_texts)
        for subgoal in job:
            if subgoal.verb == "place" and subgoal.object is not None:  # its rotation there is not known yet
                goals = destinations(task, replace(subgoal, agent=1), replace(scene, poses=poses))
                poses[subgoal.object] = goals[0]
                break
    open_jobs = [number for number, job in enumerate(jobs) if job[0].agent == ANY_AGENT]
    loads_s = np.nan_to_num(np.delete(durations_s, open_jobs, axis=0), posinf=0.0).sum(axis=0)
    assignment = assign(durations_s[open_jobs], loads_s)
    assert assignment is not None  # some agent can do each of them
    agent_of_job = dict(zip(open_jobs, assignment.agents, strict=True))
    subgoals = tuple(
        replace(subgoal, agent=agent_of_job[number] + 1) if number in agent_of_job else subgoal
        for number, job in enumerate(jobs)
        for subgoal in job
    )
    return Proposal(subgoals, tuple(_resolve_all(proposal.constraints, subgoals)))


def _jobs(subgoals: Sequence[Subgoal]) -> Iterator[Job]:
    """Splits subgoals into jobs. Raises BadAnswer where one of `ANY_AGENT` begins with another verb."""
    for (agent, name), run in groupby(subgoals, key=lambda subgoal: (subgoal.agent, subgoal.object)):
        job: list[Subgoal] = []
        for subgoal in run:
            begins_job = VERBS[subgoal.verb].meets in ("grasp", "press")
            if job and begins_job:
                yield job
                job = []
            if agent == ANY_AGENT and not job and not begins_job:
                raise BadAnswer(
                    f"anybody cannot {subgoal.text}: what anybody may do begins with grasp or press; say "
                    f"which agent goes on{f' with {name}' if name else ''}"
                )
            job.append(subgoal)
        yield job


def _job_duration_s(task: Task, reach: Reach, job: Job, state: State) -> float:
    """Estimated duration in s of a job for its agent; 0 where unknown, infinite where it cannot do it."""
    if VERBS[job[0].verb].meets not in ("grasp", "press"):
        return 0.0
    targets = frozenset({*task.objects} & {job[0].object})
    return estimated_s(Request(task, reach, job[0], job[1:]), replace(state, targets=targets))


def _resolve_all(constraints: Sequence[Statement], subgoals: Sequence[Subgoal]) -> Iterator[Statement]:
    """The constraints with the chosen agents, without orders that have become those of a single agent."""
    for constraint in constraints:
        resolved = _resolve(constraint, subgoals, constraint.sentence)
        several = not isinstance(resolved, Before) or len(set(resolved.agents)) == len(resolved.agents)
        if resolved == constraint or several:
            yield resolved


def _resolve(part: Any, subgoals: Sequence[Subgoal], sentence: str) -> Any:
    """A statement, or a step, with `ANY_AGENT` replaced by the one agent that handles its object."""
    changes: dict[str, Any] = {
        key: _resolve(value, subgoals, sentence)
        for key, value in vars(part).items()
        if isinstance(value, Step)
    }
    if getattr(part, "agent", None) == ANY_AGENT:
        name, verb = getattr(part, "object", None), getattr(part, "verb", None)
        of_object = [subgoal for subgoal in subgoals if subgoal.object == name]
        agents = {subgoal.agent for subgoal in of_object if verb in (None, subgoal.verb)}
        if len(agents) != 1 or name is None:
            raise BadAnswer(
                f"constraint {sentence!r}: it is about anybody, and {'more than one' if agents else 'no'} "
                f"agent of this plan has to do with {name or 'what it says'}; say which agent"
            )
        changes["agent"] = agents.pop()
    return replace(part, **changes) if changes else part

"""Allocation of jobs of `Anybody`: the chosen agents, and errors of jobs that need a named agent."""

import json
from dataclasses import replace

import numpy as np
import pytest

from rf_exp.datagen import Planned, Planner, Settings, allocate_jobs
from rf_exp.datagen.brain import BadAnswer, Question, ScriptedSpec, from_json, to_json
from rf_exp.errors import ArgumentError
from rf_exp.findings import Finding, Violation
from rf_exp.statements import Before, ContactAt, Proposal, Step, grasping, keep_clear, read
from rf_exp.tasks import Task, default_of, named_task
from rf_exp.types import ANY_AGENT, ConstraintSet, JointLimits, Scene, Subgoal
from tests.scenes import start_scene

LIMITS = JointLimits(**default_of("limits"))


def pool() -> Task:
    task = named_task("pool_3x4")
    assert task is not None
    return task


def fetch_subgoals(agent: int, cube: str, goal: str) -> tuple[Subgoal, Subgoal]:
    return Subgoal(agent, "grasp", cube, "center"), Subgoal(agent, "place", cube, target=goal)


def test_an_answer_may_leave_the_agent_of_a_job_open() -> None:
    task = pool()
    scene = start_scene(task, 0)
    proposal = task.module.plan(scene, task)
    text = to_json(proposal)
    assert list(json.loads(text)["Subgoals"]) == ["Anybody"]
    assert from_json(text, task) == proposal


@pytest.mark.parametrize(
    "text",
    [
        "Anybody must grasp cube1 at its center point.",
        "Any agent must grasp cube1 at its center point.",
        "Anyone must grasp cube1 at its center point.",
    ],
)
def test_sentences_about_anybody_are_read(text: str) -> None:
    assert read(text, pool().vocabulary) == ContactAt(ANY_AGENT, "grasp", "cube1", "center")


def test_an_agent_that_is_counted_from_zero_is_not_anybody() -> None:
    with pytest.raises(ArgumentError, match="Agent_0"):
        read("Agent_0 must grasp cube1 at its center point.", pool().vocabulary)


def test_every_job_gets_an_agent_and_constraints_are_adapted() -> None:
    task = pool()
    scene = start_scene(task, 0)
    found = allocate_jobs(task.module.plan(scene, task), task, scene, LIMITS)
    agents = {each.object: each.agent for each in found.subgoals}
    assert set(agents.values()) == set(task.agents) and len(agents) == 4
    assert all(agents[each.object] == each.agent for each in found.subgoals)
    stated = {each for each in found.constraints if isinstance(each, ContactAt)}
    assert stated == {ContactAt(agent, "grasp", str(name), "center") for name, agent in agents.items()}
    assert allocate_jobs(found, task, scene, LIMITS) == found


def test_busy_agents_get_fewer_jobs() -> None:
    """If two arms could do a job, the one with another job does not get it."""
    task = pool()
    scene = start_scene(task, 0)
    alone = allocate_jobs(Proposal(fetch_subgoals(ANY_AGENT, "cube1", "goal1"), ()), task, scene, LIMITS)
    nearest = alone.subgoals[0].agent
    busy = (*fetch_subgoals(nearest, "cube4", "goal4"), *fetch_subgoals(ANY_AGENT, "cube1", "goal1"))
    other = allocate_jobs(Proposal(busy, ()), task, scene, LIMITS)
    assert {each.agent for each in other.subgoals if each.object == "cube1"} != {nearest}


def test_an_order_of_jobs_of_one_agent_is_dropped() -> None:
    """Between different agents the order remains, with the chosen agents."""
    task = pool()
    scene = start_scene(task, 0)
    subgoals = (*fetch_subgoals(ANY_AGENT, "cube1", "goal1"), *fetch_subgoals(ANY_AGENT, "cube2", "goal2"))
    order = Before(Step(ANY_AGENT, "place", "cube1"), Step(ANY_AGENT, "place", "cube2"))
    found = allocate_jobs(Proposal(subgoals, (order,)), task, scene, LIMITS)
    first, second = (found.subgoals[k].agent for k in (0, 2))
    assert first != second
    assert found.constraints == (Before(Step(first, "place", "cube1"), Step(second, "place", "cube2")),)


@pytest.mark.parametrize(
    ("subgoals", "constraints", "message"),
    [
        (
            (Subgoal(ANY_AGENT, "place", "cube1", target="goal1"),),
            (),
            "anybody cannot place cube1 to goal1: what anybody may do begins with grasp or press; say which "
            "agent goes on with cube1",
        ),
        (
            (Subgoal(ANY_AGENT, "home"),),
            (),
            "anybody cannot home: what anybody may do begins with grasp or press; say which agent goes on",
        ),
        (
            fetch_subgoals(ANY_AGENT, "cube1", "goal1"),
            (ContactAt(ANY_AGENT, "grasp", "cube2", "center"),),
            "constraint 'Anybody must grasp cube2 at its center point.': it is about anybody, and no agent",
        ),
        (
            fetch_subgoals(1, "cube1", "goal1"),
            (ContactAt(ANY_AGENT, "grasp", "cube2", "center"),),
            "is about anybody, but the plan says who does what; name the agent",
        ),
    ],
)
def test_jobs_that_need_a_named_agent_are_refused(subgoals, constraints, message) -> None:
    task = pool()
    with pytest.raises(BadAnswer) as error:
        allocate_jobs(Proposal(subgoals, constraints), task, start_scene(task, 0), LIMITS)
    assert message in str(error.value)


def planned(scene: Scene, proposal: Proposal) -> Planned | Violation | None:
    class Brain:
        name = "said"

        def answer(self, question: Question) -> str:
            return to_json(proposal)

    task = pool()
    settings = Settings.configured(task, ConstraintSet("full"), ScriptedSpec())
    return Planner(settings, Brain()).plan(Question(task, scene, {}), scene, np.random.default_rng(0))


def test_a_job_out_of_reach_of_all_agents_is_a_violation() -> None:
    task = pool()
    scene = start_scene(task, 0)
    far = scene.poses["cube1"].copy()
    far[:2, 3] = (1.3, 1.3)
    scene = replace(scene, poses={**scene.poses, "cube1": far})
    found = planned(scene, Proposal(fetch_subgoals(ANY_AGENT, "cube1", "goal1"), ()))
    assert isinstance(found, Violation) and found.finding is Finding.NOBODY
    assert found.sentence == (
        "none of [Agent_1, Agent_2, Agent_3] can grasp cube1 at center and place cube1 to goal1: out of reach"
    )


@pytest.mark.slow
def test_a_plan_names_the_chosen_agents() -> None:
    task = pool()
    scene = start_scene(task, 0)
    jobs = (*fetch_subgoals(ANY_AGENT, "cube1", "goal1"), *fetch_subgoals(ANY_AGENT, "cube2", "goal2"))
    found = planned(scene, Proposal(jobs, (*grasping(jobs), *keep_clear(task.agents))))
    assert isinstance(found, Planned)
    assert {each.agent for each in found.proposal.subgoals} <= set(task.agents)

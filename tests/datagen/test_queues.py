"""Subgoal queues: the order of agents in an answer has no effect, and queues wait for one another."""

import json
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice, permutations
from unittest.mock import Mock, patch

import numpy as np
import pytest

from rf_exp.constraints.phases import times_s
from rf_exp.datagen import Planned, Planner, Settings, Unreachable, plan_commands, planning
from rf_exp.datagen.brain import Question, ScriptedSpec, to_json
from rf_exp.datagen.motion.planner import Queues, canonical_order, plan_motion
from rf_exp.findings import Cause, Finding, Violation
from rf_exp.statements import Before, Proposal, Step
from rf_exp.tasks import Task, named_task
from rf_exp.transforms import planar
from rf_exp.types import ConstraintSet, Subgoal
from tests.conftest import read_task
from tests.scenes import start_scene

FULL = ConstraintSet("full")
WITH_TIME = (FULL, ConstraintSet("logical_temporal", spatial=False))
WITH_ORDERS = ("pass_shoe", "place_food", "two_robots_stack_cube", "three_robots_stack_cube")
MAX_PERMUTATIONS = {FULL: 6, WITH_TIME[1]: 2}  # number of permutations tested, at most


class FixedBrain:
    """Brain that answers with a fixed text."""

    name = "says"

    def __init__(self, text: str) -> None:
        self._text = text

    def answer(self, question: Question) -> str:
        return self._text


def listed(proposal: Proposal, agents: Sequence[int]) -> str:
    """The paper's JSON of a proposal, with its agents in this order."""
    answer = json.loads(to_json(proposal))
    keys = [f"Agent_{agent}" for agent in agents]
    return json.dumps({**answer, "Subgoals": {key: answer["Subgoals"][key] for key in keys}})


def planned(task: Task, text: str, row: ConstraintSet = FULL) -> Planned | Violation | None:
    scene = start_scene(task, 0)
    planner = Planner(Settings.configured(task, row, ScriptedSpec()), FixedBrain(text))
    return planner.plan(Question(task, scene, {}), scene, np.random.default_rng([0, 1]))


def agents_of(proposal: Proposal) -> list[int]:
    return list(dict.fromkeys(subgoal.agent for subgoal in proposal.subgoals))


def unordered(task: Task) -> Proposal:
    """The scripted plan of seed 0 without its `Before` constraints."""
    proposal = task.module.plan(start_scene(task, 0), task)
    kept = tuple(each for each in proposal.constraints if not isinstance(each, Before))
    return replace(proposal, constraints=kept)


@pytest.mark.slow
@pytest.mark.parametrize("row", WITH_TIME, ids=lambda row: row.name)
def test_neither_motion_nor_schedule_depends_on_how_agents_are_listed(task, row):
    proposal = task.module.plan(start_scene(task, 0), task)
    agents = agents_of(proposal)
    if len(agents) < 2:
        pytest.skip("one agent")
    listings = list(permutations(agents))
    chosen = {*listings[:: -(-len(listings) // MAX_PERMUTATIONS[row])], listings[-1]}
    first, *others = (planned(task, listed(proposal, order), row) for order in sorted(chosen))
    assert isinstance(first, Planned)
    for other in others:
        assert isinstance(other, Planned)
        assert len(other.schedule) == len(first.schedule)
        assert other.schedule.makespan_bound == first.schedule.makespan_bound
        np.testing.assert_array_equal(plan_commands(other), plan_commands(first))


def test_agents_that_wait_for_no_other_come_first(task):
    """For every listing of agents: those that others wait for first, otherwise by number."""
    proposal = task.module.plan(start_scene(task, 0), task)
    found = set()
    for order in islice(permutations(agents_of(proposal)), 24):
        shuffled = replace(
            proposal, subgoals=tuple(each for agent in order for each in proposal.subgoals_of(agent))
        )
        orders = [
            ((each.first.agent, each.first.verb, each.first.object), (each.then.agent, None, None))
            for each in proposal.constraints
            if isinstance(each, Before) and isinstance(each.first, Step)
        ]
        turns = canonical_order(shuffled, orders)
        assert all(turns.subgoals_of(agent) == proposal.subgoals_of(agent) for agent in task.agents)
        places = agents_of(turns)
        assert all(places.index(first[0]) < places.index(then[0]) for first, then in orders)
        found.add(tuple(places))
    assert len(found) == 1


def test_agents_that_wait_for_each_other_are_listed_by_number():
    one, two = Subgoal(1, "home"), Subgoal(2, "home")
    orders = [((1, "home", None), (2, None, None)), ((2, "home", None), (1, None, None))]
    assert canonical_order(Proposal((two, one), ()), orders).subgoals == (one, two)


@pytest.mark.slow
@pytest.mark.parametrize("name", WITH_ORDERS)
def test_a_blocked_queue_waits_for_the_queue_that_clears_its_way(name):
    """Without a `Before` constraint the plan is as long as with it."""
    task = read_task(name)
    proposal, demanded = unordered(task), task.module.plan(start_scene(task, 0), task)
    with_order = planned(task, to_json(demanded))
    found = planned(task, listed(proposal, agents_of(proposal)[::-1]))
    assert isinstance(found, Planned)
    assert isinstance(with_order, Planned)
    assert len(found.schedule) == len(with_order.schedule)


@pytest.mark.slow
def test_an_object_of_another_agent_is_grasped_only_once_it_is_placed():
    """Without a constraint on the order: the shoe is grasped only after the other agent has placed it."""
    task = read_task("pass_shoe")
    found = planned(task, to_json(unordered(task)))
    assert isinstance(found, Planned)
    place_s = times_s(Step(1, "place", "shoe"), found.checked.plan)
    grasp_s = times_s(Step(2, "grasp", "shoe"), found.checked.plan)
    assert place_s is not None and grasp_s is not None
    assert place_s[1] <= grasp_s[0]


@pytest.mark.slow
def test_without_temporal_constraints_a_blocked_agent_passes_its_turn():
    task = read_task("place_food")
    row = ConstraintSet("logical_spatial", temporal=False)
    proposal = task.module.plan(start_scene(task, 0), task)
    found = planned(task, listed(proposal, (1, 2)), row)
    assert isinstance(found, Planned)
    lid = times_s(Step(2, "place", "lid"), found.checked.plan)
    steak = times_s(Step(1, "place", "steak"), found.checked.plan)
    assert lid is not None and steak is not None
    assert lid[1] <= steak[0]


STEAK_LIFT, LID_LIFT, HOME = Subgoal(1, "lift", "steak"), Subgoal(2, "lift", "lid"), Subgoal(2, "home")
IN_THE_WAY = Unreachable(Cause.SPACE, Finding.BLOCKED, (1,), obstacles=("lid",))
FAR_OFF = Unreachable(Cause.REACH, Finding.OUT_OF_REACH, (1,))
ARM_IN_THE_WAY = Unreachable(Cause.SPACE, Finding.BLOCKED, (1, 2), obstacles=("Agent_2",))


@pytest.mark.parametrize(
    ("error", "moved"), [(IN_THE_WAY, {"lid"}), (FAR_OFF, {"steak"}), (ARM_IN_THE_WAY, set())]
)
def test_a_stuck_agent_is_tried_again_once_its_obstacle_has_moved(error, moved):
    queues = Queues(Proposal((STEAK_LIFT, LID_LIFT, HOME), ()), (), ())
    queues.mark_stuck(queues.next(), error)
    assert queues.next() == [LID_LIFT]
    queues.mark_planned([LID_LIFT], moved)
    assert queues.next() == [HOME]  # the queue of the other agent goes on
    queues.mark_planned([HOME], ())
    assert queues.next() == [STEAK_LIFT]
    queues.mark_planned([STEAK_LIFT], {"steak"})
    assert queues.next() == ()


def test_the_last_planned_agent_goes_on_before_agents_that_waited_for_it():
    waiting, first, then = (
        Subgoal(1, "lift", "steak"),
        Subgoal(2, "lift", "lid"),
        Subgoal(2, "grasp", "pot", "left"),
    )
    order = (((2, "lift", "lid"), (1, "lift", "steak")),)
    queues, order_planned = Queues(Proposal((waiting, first, then), ()), (), order), []
    while subgoals := queues.next():
        order_planned += subgoals
        queues.mark_planned(subgoals, ())
    assert order_planned == [first, then, waiting]


@pytest.mark.parametrize("error", [IN_THE_WAY, FAR_OFF])
def test_where_no_relevant_object_moves_the_first_error_is_raised(error):
    queues = Queues(Proposal((STEAK_LIFT, LID_LIFT), ()), (), ())
    queues.mark_stuck(queues.next(), error)
    queues.mark_planned(queues.next(), {"pot"})
    with pytest.raises(Unreachable) as raised:
        queues.next()
    assert raised.value is error


def test_an_error_that_no_other_agent_can_resolve_is_raised_at_once():
    queues = Queues(Proposal((STEAK_LIFT, LID_LIFT), ()), (), ())
    empty = Unreachable(Cause.GRIP, Finding.HOLDS_NOT, (1,))
    with pytest.raises(Unreachable) as raised:
        queues.mark_stuck(queues.next(), empty)
    assert raised.value is empty


def plan_crowded(moved_by: int, motion: Mock) -> Violation | Planned | None:
    """Plan for grasping a cube between three others, one of which the agent `moved_by` grasps afterwards."""
    task = named_task("ring_2x4")
    assert task is not None
    scene = start_scene(task, 0)
    offsets_m = {"cube1_2": (0.045, 0.0), "cube1_3": (-0.045, 0.0), "cube1_4": (0.0, 0.045)}
    around = {name: scene.poses["cube1_1"] @ planar(*at, 0.0) for name, at in offsets_m.items()}
    subgoals = Subgoal(1, "grasp", "cube1_1", "center"), Subgoal(moved_by, "grasp", "cube1_2", "center")
    brain = FixedBrain(to_json(Proposal(subgoals, ())))
    planner = Planner(Settings.configured(task, FULL, ScriptedSpec()), brain)
    crowded = replace(scene, poses={**scene.poses, **around})
    with patch.object(planning, "plan_motion", motion):
        return planner.plan(Question(task, crowded, {}), crowded, np.random.default_rng(0))


@pytest.mark.slow
def test_objects_that_leave_no_room_for_the_gripper_cause_retries_only_if_another_agent_moves_them():
    motion = Mock(side_effect=plan_motion)
    found = plan_crowded(1, motion)
    assert isinstance(found, Violation) and found.finding is Finding.NO_ROOM and motion.call_count == 1
    assert "cube1_2 is in the way" in found.sentence and "cm of cube1_2" in found.sentence
    found = plan_crowded(2, motion)
    assert isinstance(found, Violation) and motion.call_count > 2


@pytest.mark.parametrize(
    "moved_by, in_the_way, once",
    [(1, (), True), (1, ("Agent_2",), False), (2, (), False), (2, ("Agent_2",), False)],
)
def test_a_blocked_arm_is_replanned_only_if_others_can_move(moved_by, in_the_way, once):
    obstacles, agents = ("cube1_2", "the arm itself", *in_the_way), (1, 2) if in_the_way else (1,)
    blocked = Unreachable(
        Cause.SPACE, Finding.BLOCKED, agents, subgoals=("grasp cube1_1",), obstacles=obstacles
    )
    motion = Mock(side_effect=blocked)
    found = plan_crowded(moved_by, motion)
    assert isinstance(found, Violation) and found.finding is Finding.BLOCKED
    assert (motion.call_count == 1) is once and (found.tried == ()) is once

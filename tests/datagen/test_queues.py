"""A plan is a set of queues: how it lists its agents says nothing, and one may wait for another."""

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
SOME = {FULL: 6, WITH_TIME[1]: 2}  # permutations of many


class Says:
    """Answers with a text."""

    name = "says"

    def __init__(self, text: str) -> None:
        self._text = text

    def answer(self, question: Question) -> str:
        return self._text


def listed(proposal: Proposal, agents: Sequence[int]) -> str:
    """The paper's JSON, its agents in this order."""
    told = json.loads(to_json(proposal))
    keys = [f"Agent_{agent}" for agent in agents]
    return json.dumps({**told, "Subgoals": {key: told["Subgoals"][key] for key in keys}})


def planned(task: Task, text: str, row: ConstraintSet = FULL) -> Planned | Violation | None:
    scene = start_scene(task, 0)
    planner = Planner(Settings.configured(task, row, ScriptedSpec()), Says(text))
    return planner.plan(Question(task, scene, {}), scene, np.random.default_rng([0, 1]))


def agents_of(proposal: Proposal) -> list[int]:
    return list(dict.fromkeys(subgoal.agent for subgoal in proposal.subgoals))


def unordered(task: Task) -> Proposal:
    """The scripted plan of seed 0 without a word about what comes before what."""
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
    every = list(permutations(agents))
    some = {*every[:: -(-len(every) // SOME[row])], every[-1]}
    first, *others = (planned(task, listed(proposal, order), row) for order in sorted(some))
    assert isinstance(first, Planned)
    for other in others:
        assert isinstance(other, Planned)
        assert len(other.schedule) == len(first.schedule)
        assert other.schedule.makespan_bound == first.schedule.makespan_bound
        np.testing.assert_array_equal(plan_commands(other), plan_commands(first))


def test_who_waits_for_nobody_comes_first(task):
    """For every listing the same; whom others wait for first, otherwise by number."""
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


def test_agents_that_wait_for_one_another_both_ways_are_listed_by_number():
    one, two = Subgoal(1, "home"), Subgoal(2, "home")
    both = [((1, "home", None), (2, None, None)), ((2, "home", None), (1, None, None))]
    assert canonical_order(Proposal((two, one), ()), both).subgoals == (one, two)


@pytest.mark.slow
@pytest.mark.parametrize("name", WITH_ORDERS)
def test_a_queue_that_is_blocked_waits_for_the_one_that_clears_its_way(name):
    """Without an order that says so: the plan is as long as with the order."""
    task = read_task(name)
    proposal, demanded = unordered(task), task.module.plan(start_scene(task, 0), task)
    with_order = planned(task, to_json(demanded))
    found = planned(task, listed(proposal, agents_of(proposal)[::-1]))
    assert isinstance(found, Planned)
    assert isinstance(with_order, Planned)
    assert len(found.schedule) == len(with_order.schedule)


@pytest.mark.slow
def test_what_another_agent_leaves_is_met_only_once_it_is_there():
    """Nobody said which comes first; the shoe is where it is grasped only after it was laid there."""
    task = read_task("pass_shoe")
    found = planned(task, to_json(unordered(task)))
    assert isinstance(found, Planned)
    given = times_s(Step(1, "place", "shoe"), found.checked.plan)
    taken = times_s(Step(2, "grasp", "shoe"), found.checked.plan)
    assert given is not None and taken is not None
    assert given[1] <= taken[0]


@pytest.mark.slow
def test_without_a_model_of_time_a_blocked_agent_leaves_its_turn_to_another():
    task = read_task("place_food")
    row = ConstraintSet("logical_spatial", temporal=False)
    proposal = task.module.plan(start_scene(task, 0), task)
    found = planned(task, listed(proposal, (1, 2)), row)
    assert isinstance(found, Planned)
    lid = times_s(Step(2, "place", "lid"), found.checked.plan)
    steak = times_s(Step(1, "place", "steak"), found.checked.plan)
    assert lid is not None and steak is not None
    assert lid[1] <= steak[0]


ONE, OTHER, LAST = Subgoal(1, "lift", "steak"), Subgoal(2, "lift", "lid"), Subgoal(2, "home")
IN_THE_WAY = Unreachable(Cause.SPACE, Finding.BLOCKED, (1,), obstacles=("lid",))
FAR_OFF = Unreachable(Cause.REACH, Finding.OUT_OF_REACH, (1,))
ARM_IN_THE_WAY = Unreachable(Cause.SPACE, Finding.BLOCKED, (1, 2), obstacles=("Agent_2",))


@pytest.mark.parametrize(
    ("error", "moved"), [(IN_THE_WAY, {"lid"}), (FAR_OFF, {"steak"}), (ARM_IN_THE_WAY, set())]
)
def test_who_was_stuck_is_tried_again_once_what_was_in_the_way_has_moved(error, moved):
    queues = Queues(Proposal((ONE, OTHER, LAST), ()), (), ())
    queues.mark_stuck(queues.next(), error)
    assert queues.next() == [OTHER]
    queues.mark_planned([OTHER], moved)
    assert queues.next() == [LAST]  # as far as the others go
    queues.mark_planned([LAST], ())
    assert queues.next() == [ONE]
    queues.mark_planned([ONE], {"steak"})
    assert queues.next() == ()


def test_who_has_gone_on_last_goes_on_before_those_who_have_waited_for_it():
    waits, first, then = (
        Subgoal(1, "lift", "steak"),
        Subgoal(2, "lift", "lid"),
        Subgoal(2, "grasp", "pot", "left"),
    )
    order = (((2, "lift", "lid"), (1, "lift", "steak")),)
    queues, met = Queues(Proposal((waits, first, then), ()), (), order), []
    while subgoals := queues.next():
        met += subgoals
        queues.mark_planned(subgoals, ())
    assert met == [first, then, waits]


@pytest.mark.parametrize("error", [IN_THE_WAY, FAR_OFF])
def test_where_nothing_moves_that_matters_the_first_reason_is_the_answer(error):
    queues = Queues(Proposal((ONE, OTHER), ()), (), ())
    queues.mark_stuck(queues.next(), error)
    queues.mark_planned(queues.next(), {"pot"})
    with pytest.raises(Unreachable) as raised:
        queues.next()
    assert raised.value is error


def test_a_reason_that_no_other_agent_can_help_is_the_answer_at_once():
    queues = Queues(Proposal((ONE, OTHER), ()), (), ())
    empty = Unreachable(Cause.GRIP, Finding.HOLDS_NOT, (1,))
    with pytest.raises(Unreachable) as raised:
        queues.mark_stuck(queues.next(), empty)
    assert raised.value is empty


def asked(moved_by: int, motion: Mock) -> Violation | Planned | None:
    """What becomes of the grasp of a cube between three others, of which an agent fetches one later."""
    task = named_task("ring_2x4")
    assert task is not None
    scene = start_scene(task, 0)
    beside = {"cube1_2": (0.045, 0.0), "cube1_3": (-0.045, 0.0), "cube1_4": (0.0, 0.045)}
    around = {name: scene.poses["cube1_1"] @ planar(*at, 0.0) for name, at in beside.items()}
    subgoals = Subgoal(1, "grasp", "cube1_1", "center"), Subgoal(moved_by, "grasp", "cube1_2", "center")
    answer = Says(to_json(Proposal(subgoals, ())))
    planner = Planner(Settings.configured(task, FULL, ScriptedSpec()), answer)
    crowded = replace(scene, poses={**scene.poses, **around})
    with patch.object(planning, "plan_motion", motion):
        return planner.plan(Question(task, crowded, {}), crowded, np.random.default_rng(0))


@pytest.mark.slow
def test_where_things_leave_the_hand_no_room_only_who_moves_them_is_a_reason_to_try_another_way():
    motion = Mock(side_effect=plan_motion)
    found = asked(1, motion)
    assert isinstance(found, Violation) and found.finding is Finding.NO_ROOM and motion.call_count == 1
    assert "cube1_2 is in the way" in found.sentence and "cm of cube1_2" in found.sentence
    found = asked(2, motion)
    assert isinstance(found, Violation) and motion.call_count > 2


@pytest.mark.parametrize(
    "moved_by, in_the_way, once",
    [(1, (), True), (1, ("Agent_2",), False), (2, (), False), (2, ("Agent_2",), False)],
)
def test_what_is_in_the_way_of_an_arm_is_so_in_every_way_unless_others_move(moved_by, in_the_way, once):
    obstacles, agents = ("cube1_2", "the arm itself", *in_the_way), (1, 2) if in_the_way else (1,)
    blocked = Unreachable(
        Cause.SPACE, Finding.BLOCKED, agents, subgoals=("grasp cube1_1",), obstacles=obstacles
    )
    motion = Mock(side_effect=blocked)
    found = asked(moved_by, motion)
    assert isinstance(found, Violation) and found.finding is Finding.BLOCKED
    assert (motion.call_count == 1) is once and (found.tried == ()) is once

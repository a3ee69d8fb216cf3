"""Agents that yield, and where to, by proposal, held objects, shared space and constraint set."""

from dataclasses import replace

import pytest

from rf_exp.datagen.yielding import PlanningMode, Yielding, planning_modes
from rf_exp.statements import Proposal, ShareSpace
from rf_exp.types import ConstraintSet, Subgoal
from tests.conftest import read_task
from tests.scenes import start_scene

SCENE = replace(start_scene(read_task("take_photo"), 0), held=(None, None, "steak", None))
PROPOSAL = Proposal((Subgoal(1, "home"),), (ShareSpace((1, 2)),))
ALL, SHARING = frozenset((1, 2, 3, 4)), frozenset((1, 2))
IDLE = 2, 4  # without subgoals and held objects


@pytest.mark.parametrize(
    ("spatial", "temporal", "expected"),
    [
        (False, False, [PlanningMode(False)]),
        (False, True, [PlanningMode(False, Yielding(once_done=SHARING))]),
        (
            True,
            False,
            [
                PlanningMode(True, Yielding((), ALL)),
                PlanningMode(True, Yielding(IDLE, ALL)),
                PlanningMode(True, Yielding(IDLE, ALL, "aside")),
            ],
        ),
        (
            True,
            True,
            [
                PlanningMode(False, Yielding((), ALL)),
                PlanningMode(True, Yielding((), ALL)),
                PlanningMode(False, Yielding(IDLE, ALL, "aside")),
            ],
        ),
    ],
)
def test_planning_modes_go_from_no_yielding_agent_to_all_idle_agents(spatial, temporal, expected):
    row = ConstraintSet("row", spatial=spatial, temporal=temporal)
    assert list(planning_modes(PROPOSAL, SCENE, row)) == expected


def test_in_the_last_mode_all_waiting_agents_without_objects_yield() -> None:
    """Also an agent with later subgoals, as it may be in the way while it waits."""
    proposal = Proposal((Subgoal(1, "home"), Subgoal(2, "home")), ())
    *others, last = planning_modes(proposal, SCENE, ConstraintSet("full"))
    assert last == PlanningMode(False, Yielding((2, 4), ALL, "aside"))
    assert others[-1] == PlanningMode(False, Yielding((4,), ALL, "aside"))


def test_agents_with_the_subgoal_hold_do_not_yield() -> None:
    proposal = Proposal((Subgoal(1, "home"), Subgoal(2, "hold")), ())
    modes = planning_modes(proposal, SCENE, ConstraintSet("full"))
    assert all(2 not in mode.yielding.first for mode in modes)


def test_no_planning_mode_is_tried_twice() -> None:
    proposal = Proposal(tuple(Subgoal(agent, "home") for agent in (1, 2, 3, 4)), ())
    for temporal in (True, False):
        found = list(planning_modes(proposal, SCENE, ConstraintSet("row", temporal=temporal)))
        assert len(found) == len(set(found))

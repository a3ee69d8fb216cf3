"""Who yields in a plan, and where to: by what is proposed, held and shared, and what a set knows."""

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
IDLE = 2, 4  # nothing is asked of them and they hold nothing


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
def test_ways_go_from_nobody_who_yields_first_to_all_who_can(spatial, temporal, expected):
    row = ConstraintSet("row", spatial=spatial, temporal=temporal)
    assert list(planning_modes(PROPOSAL, SCENE, row)) == expected


def test_at_last_whoever_does_not_begin_and_holds_nothing_yields() -> None:
    """Also one that has something to do later: where it waits for that it may be in the way."""
    proposal = Proposal((Subgoal(1, "home"), Subgoal(2, "home")), ())
    *others, last = planning_modes(proposal, SCENE, ConstraintSet("full"))
    assert last == PlanningMode(False, Yielding((2, 4), ALL, "aside"))
    assert others[-1] == PlanningMode(False, Yielding((4,), ALL, "aside"))


def test_who_is_told_to_hold_still_does() -> None:
    proposal = Proposal((Subgoal(1, "home"), Subgoal(2, "hold")), ())
    modes = planning_modes(proposal, SCENE, ConstraintSet("full"))
    assert all(2 not in mode.yielding.first for mode in modes)


def test_no_way_is_tried_twice() -> None:
    proposal = Proposal(tuple(Subgoal(agent, "home") for agent in (1, 2, 3, 4)), ())
    for temporal in (True, False):
        found = list(planning_modes(proposal, SCENE, ConstraintSet("row", temporal=temporal)))
        assert len(found) == len(set(found))

"""Who yields in a plan, and where to: by what is proposed, held and shared, and what a set knows."""

from dataclasses import replace

import pytest

from rf_exp.datagen.yielding import Way, Yielding, ways
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
        (False, False, [Way(False)]),
        (False, True, [Way(False, Yielding(once_done=SHARING))]),
        (True, False, [Way(True, Yielding((), ALL)), Way(True, Yielding(IDLE, ALL))]),
        (
            True,
            True,
            [
                Way(False, Yielding((), ALL)),
                Way(True, Yielding((), ALL)),
                Way(False, Yielding(IDLE, ALL, "aside")),
            ],
        ),
    ],
)
def test_ways_go_from_nobody_who_yields_first_to_all_who_can(spatial, temporal, expected):
    assert list(ways(PROPOSAL, SCENE, ConstraintSet("row", spatial=spatial, temporal=temporal))) == expected

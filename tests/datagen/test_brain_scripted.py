"""What the scripted brain makes of feedback: who draws aside, in which order, and who stays."""

from dataclasses import replace

import numpy as np
import pytest

from rf_exp.datagen.brain import Question, ScriptedBrain, from_json
from rf_exp.statements import Before, Step
from rf_exp.tasks.base import ASIDE_QPOS
from rf_exp.types import COLLISION, MOTION, Subgoal, Violation
from tests.conftest import read_task
from tests.scenes import start_scene

STACK = read_task("three_robots_stack_cube")
PHOTO = read_task("take_photo")


def answer(task, scene, check, cause, agents):
    feedback = (Violation(check, cause, agents, 1.0, 0.0, 0.0, "why"),)
    return from_json(ScriptedBrain().answer(Question(task, scene, {}, feedback=feedback)), task)


def leaving(task, scene, check, cause, agents):
    """The agents that are sent aside; empty where the task's own plan is proposed again."""
    proposal = answer(task, scene, check, cause, agents)
    if any(subgoal.verb == "aside" for subgoal in proposal.subgoals):
        return [subgoal.agent for subgoal in proposal.subgoals]
    assert proposal == task.module.plan(scene, task)
    return []


def test_arms_that_hit_each_other_draw_aside_first_the_one_whose_work_comes_later():
    proposal = answer(STACK, start_scene(STACK, 0), COLLISION, "contact", (1, 2))
    assert proposal.subgoals == (Subgoal(2, "aside"), Subgoal(1, "aside"))
    assert Before(Step(2), Step(1)) in proposal.constraints


@pytest.mark.parametrize(
    ("check", "cause", "agents", "expected"),
    [
        (MOTION, "space", (1, 4), [4]),  # Agent_1 cannot lift: Agent_4 is in the way
        ("ValidateSpatialOccupancy", "space", (1, 2), [2]),
        (MOTION, "space", (4,), [4]),  # no free path
        (COLLISION, "contact", (4,), [4]),  # pushes the camera
        (MOTION, "reach", (4,), []),  # what is out of reach is so from everywhere
        (MOTION, "grip", (1,), []),  # does not hold what it should lift
        (MOTION, "time", (1, 2), []),  # orders that contradict one another
        ("ValidateSpatialOccupancy", "space", (1,), []),  # comes near to a thing
        ("ValidateScheduling", "time", (1, 2), []),
        ("ValidateDirection", "interaction", (1, 2), []),
        ("ValidateSpatialOccupancy", "space", (1, 2, 4), []),
        ("RoboBrain", "answer", (), []),
    ],
)
def test_who_is_in_the_way_draws_aside(check, cause, agents, expected):
    """Agent_4 has nothing to do in the first proposal of Take Photo; Agent_2's work comes after Agent_1's."""
    assert leaving(PHOTO, start_scene(PHOTO, 0), check, cause, agents) == expected


def test_who_carries_something_with_another_stays_and_so_does_who_is_aside_already():
    scene = start_scene(PHOTO, 0)
    carrying = replace(scene, held=("camera", "camera", None, None))
    assert leaving(PHOTO, carrying, COLLISION, "contact", (1, 4)) == [4]
    qpos = scene.qpos.copy()
    qpos[3, :7] = np.array(ASIDE_QPOS) + 0.05
    assert leaving(PHOTO, replace(carrying, qpos=qpos), COLLISION, "contact", (1, 4)) == []

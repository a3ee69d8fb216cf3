"""What the scripted brain makes of feedback: who draws aside, in which order, and who stays."""

from dataclasses import replace

import numpy as np
import pytest

from rf_exp.datagen.brain import Question, ScriptedBrain, from_json
from rf_exp.tasks.base import ASIDE_QPOS
from rf_exp.types import COLLISION, MOTION, Subgoal, Violation
from tests.conftest import read_task
from tests.scenes import start_scene

STACK = read_task("three_robots_stack_cube")
PHOTO = read_task("take_photo")


def answer(task, scene, check, reason):
    feedback = (Violation(check, (), 1.0, 0.0, 0.0, reason),)
    return from_json(ScriptedBrain().answer(Question(task, scene, {}, feedback=feedback)), task)


def leaving(task, scene, check, reason):
    """The agents that are sent aside; empty where the task's own plan is proposed again."""
    proposal = answer(task, scene, check, reason)
    if any(subgoal.verb == "aside" for subgoal in proposal.subgoals):
        return [subgoal.agent for subgoal in proposal.subgoals]
    assert proposal == task.module.plan(scene, task)
    return []


def test_arms_that_hit_each_other_draw_aside_first_the_one_whose_work_comes_later():
    proposal = answer(STACK, start_scene(STACK, 0), COLLISION, "Agent_1, x, and Agent_2, y, hit each other")
    assert proposal.subgoals == (Subgoal(2, "aside"), Subgoal(1, "aside"))
    assert "Agent_2 must complete its task before Agent_1 begins." in [c.text for c in proposal.constraints]


@pytest.mark.parametrize(
    ("check", "reason", "expected"),
    [
        (MOTION, "Agent_1 cannot lift camera by 0.1 m: Agent_4 is in the way", [4]),
        ("ValidateSpatialOccupancy", "Agent_1, to x, comes within 1.5 cm of Agent_2, to y", [2]),
        (MOTION, "Agent_4 cannot press camera at shutter: no free path", [4]),
        (COLLISION, "Agent_4, standing still, pushes camera with 52 N", [4]),
        ("ValidateDirection", "the gripper of Agent_1 is 90 deg off", []),
        ("ValidateSpatialOccupancy", "Agent_1, Agent_2 and Agent_4 are close", []),
        ("RoboBrain", "the answer is not the expected JSON", []),
    ],
)
def test_who_is_in_the_way_draws_aside(check, reason, expected):
    """Agent_4 has nothing to do in the first proposal of Take Photo; Agent_2's work comes after Agent_1's."""
    assert leaving(PHOTO, start_scene(PHOTO, 0), check, reason) == expected


def test_who_carries_something_with_another_stays_and_so_does_who_is_aside_already():
    scene = start_scene(PHOTO, 0)
    hit = "Agent_1, to lift camera by 0.1 m (lift), and Agent_4, standing still, hit each other with 23 N"
    carrying = replace(scene, held=("camera", "camera", None, None))
    assert leaving(PHOTO, carrying, COLLISION, hit) == [4]
    qpos = scene.qpos.copy()
    qpos[3, :7] = np.array(ASIDE_QPOS) + 0.05
    assert leaving(PHOTO, replace(carrying, qpos=qpos), COLLISION, hit) == []

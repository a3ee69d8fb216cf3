"""What the scripted brain makes of feedback: who draws aside, in which order, and who stays."""

from dataclasses import replace

import numpy as np
import pytest

from rf_exp.constraints import Monitor, Paths, Plan, PolicyMonitor
from rf_exp.coordination import sequential
from rf_exp.datagen import Planner, Settings
from rf_exp.datagen.brain import Question, ScriptedBrain, ScriptedSpec, from_json, to_json
from rf_exp.findings import Cause, CheckName, Finding, Violation
from rf_exp.statements import Before, Deadline, KeepLevel, Proposal, Step
from rf_exp.tasks import RETRACTED_QPOS
from rf_exp.types import ConstraintSet, Subgoal, Trajectory
from tests.conftest import read_task
from tests.scenes import start_scene

STACK = read_task("three_robots_stack_cube")
PHOTO = read_task("take_photo")
CIRCLE = Before(Step(1), Step(2)), Before(Step(2), Step(1))


def answer(task, scene, violation):
    return from_json(ScriptedBrain().answer(Question(task, scene, {}, feedback=(violation,))), task)


def watched(task, scene):
    """What the monitor says of a scene in which everybody is to stand still."""
    still = tuple(Trajectory(k, scene.qpos[k - 1, :7], 1.0, ()) for k in task.agents)
    paths = Paths(task, ConstraintSet("full"), scene, still)
    found = Monitor(Plan(paths, sequential(still, Proposal((), ()))), ())(scene)
    assert found is not None
    return found


def hit(task, scene, a, b):
    return watched(task, replace(scene, arm_contacts=((a, b, 30.0),)))


def leaving(task, scene, violation):
    """The agents that are sent aside; empty where the task's own plan is proposed again."""
    proposal = answer(task, scene, violation)
    if any(subgoal.verb == "aside" for subgoal in proposal.subgoals):
        return [subgoal.agent for subgoal in proposal.subgoals]
    assert proposal == task.module.plan(scene, task)
    return []


def test_arms_that_hit_each_other_draw_aside_first_the_one_whose_work_comes_later():
    scene = start_scene(STACK, 0)
    proposal = answer(STACK, scene, hit(STACK, scene, 1, 2))
    assert proposal.subgoals == (Subgoal(2, "aside"), Subgoal(1, "aside"))
    assert Before(Step(2), Step(1)) in proposal.constraints


def planned(proposal):
    """What the planner says of a proposal for Take Photo."""

    class Says(ScriptedBrain):
        def answer(self, question):
            return proposal if isinstance(proposal, str) else to_json(proposal)

    scene, settings = start_scene(PHOTO, 0), Settings(PHOTO, ConstraintSet("full"), ScriptedSpec())
    found = Planner(settings, Says()).plan(Question(PHOTO, scene, {}), scene, np.random.default_rng(0))
    assert isinstance(found, Violation)
    return found


def test_what_hits_a_thing_draws_aside_and_so_does_one_of_two_that_press():
    """Agent_4 has nothing to do in the first proposal of Take Photo; Agent_2's work comes after Agent_1's."""
    scene = start_scene(PHOTO, 0)
    pushes = watched(PHOTO, replace(scene, finger_forces={(4, "camera"): np.array([0.0, 0.0, -30.0])}))
    assert pushes.finding is Finding.PUSHES and pushes.obstacles == ("camera",)
    assert leaving(PHOTO, scene, pushes) == [4]
    pressed = PolicyMonitor(PHOTO)(replace(scene, arm_contacts=((1, 2, 12.0),)))
    assert pressed is not None and leaving(PHOTO, scene, pressed) == [2]


@pytest.mark.parametrize(
    ("proposal", "cause", "agents"),
    [
        (Proposal((Subgoal(1, "lift", "camera", height_m=0.1),), ()), Cause.GRIP, (1,)),
        (Proposal((Subgoal(1, "home"), Subgoal(2, "home")), CIRCLE), Cause.TIME, (1, 2)),
        (Proposal((Subgoal(1, "home"),), (Deadline(Step(1), 0.0),)), Cause.TIME, (1,)),
        (Proposal((Subgoal(1, "home"),), (KeepLevel("lid", 5.0, 1),)), Cause.ANSWER, ()),
        ("no JSON", Cause.ANSWER, ()),
    ],
)
def test_what_no_arm_in_the_way_explains_moves_nobody(proposal, cause, agents):
    found = planned(proposal)
    assert (found.cause, found.agents, found.measured) == (cause, agents, False)
    assert leaving(PHOTO, start_scene(PHOTO, 0), found) == []


@pytest.mark.parametrize(
    ("check", "cause", "agents", "expected"),
    [
        (CheckName.MOTION, Cause.SPACE, (1, 4), [4]),  # Agent_1 cannot lift: Agent_4 is in the way
        (CheckName.MOTION, Cause.SPACE, (4,), [4]),  # no free path
        (CheckName.MOTION, Cause.REACH, (4,), []),  # what is out of reach is so from everywhere
        (CheckName.OCCUPANCY, Cause.SPACE, (1,), []),  # comes near to a thing
        (CheckName.DIRECTION, Cause.INTERACTION, (1, 2), []),
        (CheckName.OCCUPANCY, Cause.SPACE, (1, 2, 4), []),
    ],
)
def test_who_is_in_the_way_draws_aside(check, cause, agents, expected):
    found = Violation(check=check, cause=cause, agents=agents, time_s=1.0)
    assert leaving(PHOTO, start_scene(PHOTO, 0), found) == expected


def test_who_carries_something_with_another_stays_and_so_does_who_is_aside_already():
    scene = start_scene(PHOTO, 0)
    carrying = replace(scene, held=("camera", "camera", None, None))
    assert leaving(PHOTO, carrying, hit(PHOTO, carrying, 1, 4)) == [4]
    qpos = scene.qpos.copy()
    qpos[3, :7] = np.array(RETRACTED_QPOS) + 0.05
    aside = replace(carrying, qpos=qpos)
    assert leaving(PHOTO, aside, hit(PHOTO, aside, 1, 4)) == []

"""What the scripted brain makes of feedback: who draws aside, in which order, and who stays."""

from dataclasses import replace

import numpy as np
import pytest

from rf_exp.constraints import Monitor, Paths, Plan, PolicyMonitor
from rf_exp.coordination import sequential
from rf_exp.datagen import Planner, Settings
from rf_exp.datagen.brain import Question, ScriptedBrain, ScriptedSpec, from_json, to_json
from rf_exp.findings import Cause, CheckName, Finding, Violation
from rf_exp.geometry import AGENT_MARGIN_M, PlanningScene, nearest
from rf_exp.robots import DEFAULT, Arm
from rf_exp.statements import Before, Deadline, KeepLevel, Proposal, Step, Together
from rf_exp.transforms import transform
from rf_exp.types import ConstraintSet, Subgoal, Trajectory
from tests.conftest import read_task
from tests.scenes import start_scene

STACK = read_task("three_robots_stack_cube")
PHOTO = read_task("take_photo")
START = start_scene(PHOTO, 0)
FULL, SPATIAL = ConstraintSet("full"), ConstraintSet("logical_spatial", temporal=False)
MOTION, SCHEDULING, OCCUPANCY = CheckName.MOTION, CheckName.SCHEDULING, CheckName.OCCUPANCY
CIRCLE = Before(Step(1), Step(2)), Before(Step(2), Step(1))


def answer(task, scene, violation):
    return from_json(ScriptedBrain().answer(Question(task, scene, {}, feedback=(violation,))), task)


def watched(task, scene):
    """What the monitor says of a scene in which everybody is to stand still."""
    still = tuple(Trajectory(k, scene.qpos[k - 1, :7], 1.0, ()) for k in task.agents)
    paths = Paths(task, FULL, scene, still)
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


def planned(proposal, scene=START, row=FULL):
    """What the planner says of a proposal for Take Photo."""

    class Says(ScriptedBrain):
        def answer(self, question):
            return proposal if isinstance(proposal, str) else to_json(proposal)

    settings, question = Settings.configured(PHOTO, row, ScriptedSpec()), Question(PHOTO, scene, {})
    found = Planner(settings, Says()).plan(question, scene, np.random.default_rng(0))
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
    assert leaving(PHOTO, START, found) == []


def reaching(scene, agent, point, shift_m):
    """The scene with the fingers of an agent beside a point of the camera."""
    arm = Arm(DEFAULT, PHOTO.robots[agent - 1].world_from_base)
    tcp = scene.poses["camera"] @ PHOTO.asset("camera").points[point].object_from_tcp
    joints = arm.solve(transform(shift_m) @ tcp, scene.qpos[agent - 1, :-2])
    assert joints is not None
    qpos = scene.qpos.copy()
    qpos[agent - 1, :-2] = joints
    return replace(scene, qpos=qpos)


OVER_THE_GRIP = reaching(START, 4, "left", (0.0, 0.0, 0.05))
IN_THE_CAMERA = reaching(START, 4, "shutter", (0.0, 0.0, -0.03))
BESIDE_THE_SHUTTER = reaching(reaching(START, 1, "left", (0, 0.07, 0.1)), 2, "right", (0, -0.07, 0.1))
FAR = replace(START, poses={**START.poses, "camera": transform((2.0, 0.0, 0.0)) @ START.poses["camera"]})
HELD = replace(START, held=("camera", "camera", None, None))
GRASP, PRESS = Subgoal(1, "grasp", "camera", "left"), Subgoal(4, "press", "camera", "shutter")
UNEVEN = Proposal(
    tuple(Subgoal(agent, "lift", "camera", height_m=0.05 + 0.05 * agent) for agent in (1, 2)),
    (Together((1, 2), "lift", "camera"),),
)


def only(*subgoals):
    return Proposal(subgoals, ())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "proposal", "row", "found", "expected"),
    [
        # Agent_1 cannot grasp for Agent_4, with a model of time and without.
        (OVER_THE_GRIP, only(GRASP, Subgoal(4, "hold")), SPATIAL, (MOTION, Cause.SPACE, (1, 4)), [4]),
        (OVER_THE_GRIP, only(GRASP, Subgoal(4, "hold")), FULL, (SCHEDULING, Cause.SPACE, (1, 4)), [4]),
        # No free path.
        (IN_THE_CAMERA, only(Subgoal(4, "home")), FULL, (MOTION, Cause.SPACE, (4,)), [4]),
        # What is out of reach is so from everywhere.
        (FAR, only(PRESS), FULL, (MOTION, Cause.REACH, (4,)), []),
        # Stands too near to a thing.
        (IN_THE_CAMERA, only(Subgoal(4, "hold")), FULL, (OCCUPANCY, Cause.SPACE, (4,)), []),
        (HELD, UNEVEN, FULL, (MOTION, Cause.INTERACTION, (1, 2)), []),
        # Nothing says which of two that are in the way of a third should leave.
        (
            BESIDE_THE_SHUTTER,
            only(PRESS, Subgoal(1, "hold"), Subgoal(2, "hold")),
            SPATIAL,
            (MOTION, Cause.SPACE, (4, 1, 2)),
            [],
        ),
    ],
)
def test_who_is_in_the_way_draws_aside(scene, proposal, row, found, expected):
    violation = planned(proposal, scene, row)
    assert (violation.check, violation.cause, violation.agents) == found
    assert leaving(PHOTO, scene, violation) == expected


def test_a_refusal_says_which_part_by_how_much_and_what_was_tried():
    violation = planned(only(GRASP, Subgoal(4, "hold")), OVER_THE_GRIP, SPATIAL)
    part, other = violation.parts
    assert part.startswith("panda_") and other.startswith("panda_") and other.endswith(" of Agent_4")
    assert violation.value < violation.bound == AGENT_MARGIN_M and violation.unit == "m"
    assert violation.sentence == (
        f"Agent_1 cannot grasp camera at left: Agent_4 is in the way (its {part} comes within "
        f"{violation.value * 100:.1f} cm of {other}; at least {AGENT_MARGIN_M * 100:.1f} cm); paths were "
        "tried round the other arms, then round the other arms, with Agent_2, Agent_3 retracted first, "
        "then round the other arms, with Agent_2, Agent_3 retracted first, each retracted once done"
    )
    stuck = planned(only(Subgoal(4, "home")), IN_THE_CAMERA)
    fingers = PlanningScene(PHOTO, IN_THE_CAMERA).arm(4, IN_THE_CAMERA.qpos[3, :-2], touches=())
    gap = nearest(fingers, PlanningScene(PHOTO, IN_THE_CAMERA).static_objects(["camera"]))
    assert gap is not None and (stuck.value, stuck.parts) == (gap.distance_m, (gap.a, "camera"))
    assert f"no free path (where it stands its {gap.a} comes within" in stuck.sentence
    assert len(stuck.tried) == 3
    circle = planned(Proposal((Subgoal(1, "home"), Subgoal(2, "home")), CIRCLE))
    assert circle.tried == ()  # another way round the arms does not help


def test_who_carries_something_with_another_stays_and_so_does_who_is_aside_already():
    scene = start_scene(PHOTO, 0)
    carrying = replace(scene, held=("camera", "camera", None, None))
    assert leaving(PHOTO, carrying, hit(PHOTO, carrying, 1, 4)) == [4]
    qpos = scene.qpos.copy()
    qpos[3, :7] = np.array(DEFAULT.aside_rad) + 0.05
    aside = replace(carrying, qpos=qpos)
    assert leaving(PHOTO, aside, hit(PHOTO, aside, 1, 4)) == []

"""Reaction of the scripted brain to feedback: which agents move aside, in which order, and which stay."""

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


def monitored(task, scene):
    """The violation that the monitor finds in a scene where all arms should rest."""
    still = tuple(Trajectory(k, scene.qpos[k - 1, :7], 1.0, ()) for k in task.agents)
    paths = Paths(task, FULL, scene, still)
    found = Monitor(Plan(paths, sequential(still, Proposal((), ()))), ())(scene)
    assert found is not None
    return found


def arm_contact(task, scene, a, b):
    return monitored(task, replace(scene, arm_contacts=((a, b, 30.0),)))


def sent_aside(task, scene, violation):
    """The agents that are sent aside; empty where the scripted plan is proposed again."""
    proposal = answer(task, scene, violation)
    if any(subgoal.verb == "aside" for subgoal in proposal.subgoals):
        return [subgoal.agent for subgoal in proposal.subgoals]
    assert proposal == task.module.plan(scene, task)
    return []


def test_colliding_arms_move_aside_first_the_one_with_later_work():
    scene = start_scene(STACK, 0)
    proposal = answer(STACK, scene, arm_contact(STACK, scene, 1, 2))
    assert proposal.subgoals == (Subgoal(2, "aside"), Subgoal(1, "aside"))
    assert Before(Step(2), Step(1)) in proposal.constraints


def planned(proposal, scene=START, row=FULL):
    """The violation that the planner finds in a proposal for Take Photo."""

    class FixedBrain(ScriptedBrain):
        def answer(self, question):
            return proposal if isinstance(proposal, str) else to_json(proposal)

    settings, question = Settings.configured(PHOTO, row, ScriptedSpec()), Question(PHOTO, scene, {})
    found = Planner(settings, FixedBrain()).plan(question, scene, np.random.default_rng(0))
    assert isinstance(found, Violation)
    return found


def test_an_arm_that_pushes_an_object_moves_aside_and_so_does_one_of_two_in_contact():
    """In the first proposal of Take Photo, Agent_4 is idle and Agent_2 works after Agent_1."""
    scene = start_scene(PHOTO, 0)
    pushes = monitored(PHOTO, replace(scene, finger_forces={(4, "camera"): np.array([0.0, 0.0, -30.0])}))
    assert pushes.finding is Finding.PUSHES and pushes.obstacles == ("camera",)
    assert sent_aside(PHOTO, scene, pushes) == [4]
    pressed = PolicyMonitor(PHOTO)(replace(scene, arm_contacts=((1, 2, 12.0),)))
    assert pressed is not None and sent_aside(PHOTO, scene, pressed) == [2]


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
def test_no_agent_moves_aside_for_errors_without_a_blocking_arm(proposal, cause, agents):
    found = planned(proposal)
    assert (found.cause, found.agents, found.measured) == (cause, agents, False)
    assert sent_aside(PHOTO, START, found) == []


def with_gripper_at(scene, agent, point, shift_m):
    """The scene with the fingers of an agent beside a point of the camera."""
    arm = Arm(DEFAULT, PHOTO.robots[agent - 1].world_from_base)
    tcp = scene.poses["camera"] @ PHOTO.asset("camera").points[point].object_from_tcp
    joints = arm.solve(transform(shift_m) @ tcp, scene.qpos[agent - 1, :-2])
    assert joints is not None
    qpos = scene.qpos.copy()
    qpos[agent - 1, :-2] = joints
    return replace(scene, qpos=qpos)


OVER_POINT = with_gripper_at(START, 4, "left", (0.0, 0.0, 0.05))
IN_THE_CAMERA = with_gripper_at(START, 4, "shutter", (0.0, 0.0, -0.03))
BESIDE_THE_SHUTTER = with_gripper_at(
    with_gripper_at(START, 1, "left", (0, 0.07, 0.1)), 2, "right", (0, -0.07, 0.1)
)
FAR = replace(START, poses={**START.poses, "camera": transform((2.0, 0.0, 0.0)) @ START.poses["camera"]})
HELD = replace(START, held=("camera", "camera", None, None))
GRASP, PRESS = Subgoal(1, "grasp", "camera", "left"), Subgoal(4, "press", "camera", "shutter")
UNEVEN = Proposal(
    tuple(Subgoal(agent, "lift", "camera", height_m=0.05 + 0.05 * agent) for agent in (1, 2)),
    (Together((1, 2), "lift", "camera"),),
)


def proposal_of(*subgoals):
    return Proposal(subgoals, ())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "proposal", "row", "found", "expected"),
    [
        # Agent_4 blocks the grasp of Agent_1, without and with temporal constraints.
        (OVER_POINT, proposal_of(GRASP, Subgoal(4, "hold")), SPATIAL, (MOTION, Cause.SPACE, (1, 4)), [4]),
        (OVER_POINT, proposal_of(GRASP, Subgoal(4, "hold")), FULL, (SCHEDULING, Cause.SPACE, (1, 4)), [4]),
        # No free path.
        (IN_THE_CAMERA, proposal_of(Subgoal(4, "home")), FULL, (MOTION, Cause.SPACE, (4,)), [4]),
        # Out of reach from everywhere.
        (FAR, proposal_of(PRESS), FULL, (MOTION, Cause.REACH, (4,)), []),
        # Too near to an object.
        (IN_THE_CAMERA, proposal_of(Subgoal(4, "hold")), FULL, (OCCUPANCY, Cause.SPACE, (4,)), []),
        (HELD, UNEVEN, FULL, (MOTION, Cause.INTERACTION, (1, 2)), []),
        # Ambiguous which of two blocking agents should leave.
        (
            BESIDE_THE_SHUTTER,
            proposal_of(PRESS, Subgoal(1, "hold"), Subgoal(2, "hold")),
            SPATIAL,
            (MOTION, Cause.SPACE, (4, 1, 2)),
            [],
        ),
    ],
)
def test_blocking_agents_move_aside(scene, proposal, row, found, expected):
    violation = planned(proposal, scene, row)
    assert (violation.check, violation.cause, violation.agents) == found
    assert sent_aside(PHOTO, scene, violation) == expected


def test_a_refusal_names_the_part_the_distance_and_the_attempts():
    violation = planned(proposal_of(GRASP, Subgoal(4, "hold")), OVER_POINT, SPATIAL)
    part, other = violation.parts
    assert part.startswith("panda_") and other.startswith("panda_") and other.endswith(" of Agent_4")
    assert violation.value < violation.bound == AGENT_MARGIN_M and violation.unit == "m"
    assert violation.sentence == (
        f"Agent_1 cannot grasp camera at left: Agent_4 is in the way (its {part} comes within "
        f"{violation.value * 100:.1f} cm of {other}; at least {AGENT_MARGIN_M * 100:.1f} cm); paths were "
        "tried round the other arms, then round the other arms, with Agent_2, Agent_3 retracted first, "
        "then round the other arms, with Agent_2, Agent_3 retracted first, each retracted once done"
    )
    stuck = planned(proposal_of(Subgoal(4, "home")), IN_THE_CAMERA)
    fingers = PlanningScene(PHOTO, IN_THE_CAMERA).arm(4, IN_THE_CAMERA.qpos[3, :-2], touches=())
    gap = nearest(fingers, PlanningScene(PHOTO, IN_THE_CAMERA).static_objects(["camera"]))
    assert gap is not None and (stuck.value, stuck.parts) == (gap.distance_m, (gap.a, "camera"))
    assert f"no free path (where it stands its {gap.a} comes within" in stuck.sentence
    assert len(stuck.tried) == 3
    circular = planned(Proposal((Subgoal(1, "home"), Subgoal(2, "home")), CIRCLE))
    assert circular.tried == ()  # another path round the arms does not help


def test_agents_with_a_shared_load_stay_and_so_do_agents_already_aside():
    scene = start_scene(PHOTO, 0)
    carrying = replace(scene, held=("camera", "camera", None, None))
    assert sent_aside(PHOTO, carrying, arm_contact(PHOTO, carrying, 1, 4)) == [4]
    qpos = scene.qpos.copy()
    qpos[3, :7] = np.array(DEFAULT.aside_rad) + 0.05
    aside = replace(carrying, qpos=qpos)
    assert sent_aside(PHOTO, aside, arm_contact(PHOTO, aside, 1, 4)) == []

"""Choices of a motion count what comes after it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rf_exp.datagen.motion import branches, request
from rf_exp.datagen.motion.reach import above
from rf_exp.datagen.motion.request import DEFAULT_LIFT_M
from rf_exp.datagen.motion.timing import duration_s
from rf_exp.geometry import PlanningScene
from rf_exp.robots import DEFAULT
from rf_exp.statements import Proposal
from rf_exp.tasks import default_of
from rf_exp.transforms import planar, transform
from rf_exp.types import CONTROL_DT_S, JointLimits, Subgoal
from tests.conftest import read_task
from tests.datagen.test_motion import plan
from tests.scenes import start_scene

LIMITS = JointLimits(**default_of("limits"))


def steps(trajectories, agent):
    return sum(map(len, trajectories[agent - 1].segments))


@pytest.mark.slow
def test_a_thing_is_laid_so_that_giver_and_taker_need_the_least_together():
    task, known, unknown = read_task("long_pipeline_delivery"), 0, 0
    for seed in range(3):
        scene = start_scene(task, seed)
        give = tuple(each for each in task.module.plan(scene, task).subgoals if each.agent == 4)
        take = Subgoal(3, "grasp", "shoe", "center")
        together, _ = plan(task, Proposal((*give, take), ()), scene)
        alone, laid = plan(task, Proposal(give, ()), scene)
        then, _ = plan(task, Proposal((take,), ()), replace(scene, poses=dict(laid.poses)))
        known += steps(together, 4) + steps(together, 3)
        unknown += steps(alone, 4) + steps(then, 3)
    assert known < unknown


@pytest.mark.slow
def test_a_thing_is_grasped_so_that_it_is_soon_lifted_though_nothing_is_said_of_that(monkeypatch):
    """RoboBrain proposes stage by stage: a grasp, and what it is for once the thing is in the hand."""
    task = read_task("take_photo")

    def altogether(seed):
        scene, total = start_scene(task, seed), 0
        for agent, point in ((1, "left"), (2, "right")):
            grasped, held = plan(task, Proposal((Subgoal(agent, "grasp", "camera", point),), ()), scene)
            line = straight_up(task, scene, agent, held.qpos[agent])
            total += steps(grasped, agent) + line
        return total

    def straight_up(task, scene, agent, joints):
        arm = PlanningScene(task, scene).arms[agent - 1]
        points = branches.straight_line(arm, joints, above(arm.tcp(joints), DEFAULT_LIFT_M), LIMITS)
        assert points is not None
        return float(duration_s(points, LIMITS)) / CONTROL_DT_S

    known = sum(map(altogether, range(4)))
    monkeypatch.setattr(request, "_lift_line", lambda reach, agent, height_m, points: points[-1:])
    assert known < sum(map(altogether, range(4)))


def test_the_way_back_and_to_rest_counts_where_an_arm_arrives(lift_barrier):
    arm, rest = lift_barrier.arms[1], np.array(DEFAULT.rest_rad)
    down = transform(rotation=Rotation.from_euler("x", np.pi))
    goals = np.stack([arm.world_from_base @ planar(0.5, -0.3, angle) @ down for angle in range(6)])
    goals[:, 2, 3] = 0.1
    start = np.array([1.2, 0.3, -0.4, -2.2, 0.2, 2.4, 0.3])

    def altogether_s(points):  # there, down, up again, and to rest
        return duration_s(points, LIMITS) + branches.departure_s(points[1], points[2], rest, LIMITS)

    def chosen(posture):
        found = branches.Arrivals(arm, above(goals, 0.1), goals, posture).nearest(start)
        assert found.shape == (6, 3, 7) and np.array_equal(found[:, 0], np.tile(start, (6, 1)))
        return found

    with_rest, without = (chosen(posture) for posture in (rest, None))
    assert sum(map(altogether_s, with_rest)) < sum(map(altogether_s, without))
    assert duration_s(without, LIMITS).sum() < duration_s(with_rest, LIMITS).sum()

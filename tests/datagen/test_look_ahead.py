"""Look-ahead: the choice of a motion includes the cost of what follows it."""

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


def count_steps(trajectories, agent):
    return sum(map(len, trajectories[agent - 1].segments))


@pytest.mark.slow
def test_an_object_is_placed_so_that_giver_and_taker_need_the_least_time():
    task, with_look_ahead, without_look_ahead = read_task("long_pipeline_delivery"), 0, 0
    for seed in range(3):
        scene = start_scene(task, seed)
        give = tuple(each for each in task.module.plan(scene, task).subgoals if each.agent == 4)
        take = Subgoal(3, "grasp", "shoe", "center")
        together, _ = plan(task, Proposal((*give, take), ()), scene)
        alone, laid = plan(task, Proposal(give, ()), scene)
        then, _ = plan(task, Proposal((take,), ()), replace(scene, poses=dict(laid.poses)))
        with_look_ahead += count_steps(together, 4) + count_steps(together, 3)
        without_look_ahead += count_steps(alone, 4) + count_steps(then, 3)
    assert with_look_ahead < without_look_ahead


@pytest.mark.slow
def test_a_grasp_is_chosen_for_a_quick_lift_that_is_not_yet_proposed(monkeypatch):
    """RoboBrain proposes stage by stage: first a grasp, and the motion of the held object afterwards."""
    task = read_task("take_photo")

    def total_steps(seed):
        scene, total = start_scene(task, seed), 0
        for agent, point in ((1, "left"), (2, "right")):
            grasped, held = plan(task, Proposal((Subgoal(agent, "grasp", "camera", point),), ()), scene)
            lift = lift_steps(task, scene, agent, held.qpos[agent])
            total += count_steps(grasped, agent) + lift
        return total

    def lift_steps(task, scene, agent, joints):
        arm = PlanningScene(task, scene).arms[agent - 1]
        points = branches.straight_line(arm, joints, above(arm.tcp(joints), DEFAULT_LIFT_M), LIMITS)
        assert points is not None
        return float(duration_s(points, LIMITS)) / CONTROL_DT_S

    with_look_ahead = sum(map(total_steps, range(4)))
    monkeypatch.setattr(request, "_lift_line", lambda reach, agent, height_m, points: points[-1:])
    assert with_look_ahead < sum(map(total_steps, range(4)))


def test_arrivals_count_the_way_back_to_rest(lift_barrier):
    arm, rest = lift_barrier.arms[1], np.array(DEFAULT.rest_rad)
    down = transform(rotation=Rotation.from_euler("x", np.pi))
    goals = np.stack([arm.world_from_base @ planar(0.5, -0.3, angle) @ down for angle in range(6)])
    goals[:, 2, 3] = 0.1
    start = np.array([1.2, 0.3, -0.4, -2.2, 0.2, 2.4, 0.3])

    def total_s(points):  # to the goal, down, up again, and to rest
        return duration_s(points, LIMITS) + branches.departure_s(points[1], points[2], rest, LIMITS)

    def chosen(posture):
        found = branches.Arrivals(arm, above(goals, 0.1), goals, posture).nearest(start)
        assert found.shape == (6, 3, 7) and np.array_equal(found[:, 0], np.tile(start, (6, 1)))
        return found

    with_rest, without = (chosen(posture) for posture in (rest, None))
    assert sum(map(total_s, with_rest)) < sum(map(total_s, without))
    assert duration_s(without, LIMITS).sum() < duration_s(with_rest, LIMITS).sum()

"""The verb `shut`: a sweep about a hinge, the fall of the lid, and the predicted state after planning."""

from dataclasses import replace

import numpy as np
import pytest

from rf_exp.constraints import Paths, limit_speeds
from rf_exp.datagen import State, Unreachable
from rf_exp.statements import Proposal, read_subgoal
from rf_exp.tasks import Task
from rf_exp.types import GRIPPER_CLOSED, ConstraintSet, Scene, Subgoal, Trajectory
from tests.conftest import read_task
from tests.datagen.test_motion import plan
from tests.scenes import start_scene

SHUT = Subgoal(3, "shut", "lid", "top")
TOUCH_M = 0.006  # largest gap between finger tips and plate that counts as contact


@pytest.fixture(scope="module")
def task() -> Task:
    return read_task("three_robots_place_shoes")


@pytest.fixture(scope="module")
def swept(task: Task) -> tuple[Scene, Trajectory, State]:
    """Initial scene, the trajectory that shuts its lid, and the predicted state after it."""
    scene = start_scene(task, 0)
    (_, _, trajectory), state = plan(task, Proposal((SHUT,), ()), scene)
    return scene, trajectory, state


def test_closed_fingers_approach_sweep_wait_and_retreat(task: Task, swept) -> None:
    _, trajectory, _ = swept
    assert [each.primitive for each in trajectory.segments] == ["close", "approach", "shut", "retreat"]
    assert all((each.gripper == GRIPPER_CLOSED).all() for each in trajectory.segments)
    hinge, sweep = task.asset("lid").hinge, trajectory.segments[2]
    assert hinge is not None and sweep.hinge_rad is not None
    assert sweep.attached == "lid" and sweep.grasped_object is None and len(sweep.hinge_rad) == len(sweep)
    opened_deg = np.rad2deg(sweep.hinge_rad)
    assert (np.diff(opened_deg) < 0).all() and opened_deg[-1] == 0
    resting = (sweep.qpos == sweep.qpos[-1]).all(axis=1)
    assert opened_deg[resting].max() == pytest.approx(hinge.falls_deg, abs=0.2)
    assert resting.sum() == pytest.approx(20 * hinge.falls_s + 1, abs=1)


def test_the_lid_turns_as_slowly_as_it_is_swept(task: Task, swept) -> None:
    scene, trajectory, _ = swept
    slowed = limit_speeds(_trajectories(task, scene, trajectory), [*task.arms.values()], {3: 0.05})
    sweep = slowed[2].segments[2]
    assert sweep.hinge_rad is not None and len(sweep) > 2 * len(trajectory.segments[2])
    assert len(sweep.hinge_rad) == len(sweep) and sweep.hinge_rad[-1] == 0
    body = Paths(task, ConstraintSet("full"), scene, slowed).swept[2]
    np.testing.assert_allclose(body.poses[-1, body.labels.index("lid")], _closed_pose(task, scene))


def test_the_finger_tips_stay_on_the_plate_while_they_sweep(task: Task, swept) -> None:
    scene, trajectory, _ = swept
    paths = Paths(task, ConstraintSet("full"), scene, _trajectories(task, scene, trajectory))
    body, (_, begin, end) = paths.swept[2], list(trajectory.intervals)[2]
    lid = [k for k, label in enumerate(body.labels) if label == "lid"]
    np.testing.assert_allclose(body.poses[begin, lid[0]], scene.poses["lid"], atol=1e-9)
    np.testing.assert_allclose(
        body.poses[end:, lid[0]], np.tile(_closed_pose(task, scene), (len(body) - end, 1, 1))
    )
    top_m = float(task.asset("lid").bounds_m[1, 2])
    for row in range(begin, end - 28):  # until the lid falls
        tips = [
            (np.linalg.inv(body.poses[row, lid[0]]) @ body.poses[row, k] @ np.append(corner, 1.0))[2]
            for k, label in enumerate(body.labels)
            if "finger" in label
            for corner in task.arms[3].robot.hulls[label].vertices
        ]
        assert -0.001 < min(tips) - top_m < TOUCH_M


def _trajectories(task: Task, scene: Scene, trajectory: Trajectory) -> tuple[Trajectory, ...]:
    idle = [Trajectory(agent, scene.qpos[agent - 1, :7], 1.0, ()) for agent in (1, 2)]
    return (*idle, trajectory)


def _closed_pose(task: Task, scene: Scene):
    return task.hinged_poses("lid", scene.poses, 0.0)


def test_planning_predicts_that_the_lid_is_shut(task: Task, swept) -> None:
    scene, trajectory, state = swept
    np.testing.assert_allclose(state.poses["lid"], _closed_pose(task, scene), atol=1e-12)
    paths = Paths(task, ConstraintSet("full"), scene, _trajectories(task, scene, trajectory))
    assert "lid" in paths.planning_scene.moved
    finer = paths.refined(3)
    piece = finer.labels.index("lid")
    angles = task.hinge_rad("lid", {**scene.poses, "lid": finer.poses[:, piece]})
    assert np.abs(np.diff(angles)).max() < 0.02 and angles[-1] == pytest.approx(0.0, abs=1e-9)


def test_a_lid_that_falls_by_itself_needs_no_motion(task: Task) -> None:
    scene = start_scene(task, 0)
    poses = {**scene.poses, "lid": task.hinged_poses("lid", scene.poses, 0.3)}
    (_, _, trajectory), state = plan(task, Proposal((SHUT,), ()), replace(scene, poses=poses))
    assert len(trajectory) == 0
    np.testing.assert_allclose(state.poses["lid"], poses["lid"])


def test_an_agent_out_of_reach_is_reported(task: Task) -> None:
    with pytest.raises(Unreachable, match="Agent_1 cannot shut lid at top: out of reach"):
        plan(task, Proposal((Subgoal(1, "shut", "lid", "top"),), ()), start_scene(task, 0))


def test_a_subgoal_text_names_the_object_and_point_to_shut(task: Task) -> None:
    assert read_subgoal(3, "shut lid at top", task.vocabulary) == SHUT

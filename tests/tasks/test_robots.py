"""Other robot models in a task by a key: base poses, names of tasks, and refused values."""

import pytest

from rf_exp.artifacts import plain
from rf_exp.constraints import RoboChecker
from rf_exp.errors import ArgumentError
from rf_exp.geometry import AGENT_MARGIN_M, PlanningScene
from rf_exp.robots import DEFAULT, known_robots, robot_named
from rf_exp.tasks import Task, named_task, stored_task
from rf_exp.types import ConstraintSet
from tests.conftest import experiment, read_task
from tests.scenes import start_scene

XARM7 = robot_named("xarm7")


def task_of(*overrides: str) -> Task:
    (task,) = experiment(*overrides).tasks
    return task


def test_one_robot_is_used_at_every_base_and_nearer_by_its_shorter_reach() -> None:
    task, default_task = task_of("task=lift_barrier", "robot=xarm7"), read_task("lift_barrier")
    assert (task.name, task.title) == ("lift_barrier-xarm7", "Lift Barrier (xarm7)")
    assert [robot.model for robot in task.robots] == [XARM7, XARM7]
    nearer_m = DEFAULT.reach_m - XARM7.reach_m
    for robot, before in zip(task.robots, default_task.robots, strict=True):
        assert robot.x_m == before.x_m and abs(before.y_m) - abs(robot.y_m) == pytest.approx(nearer_m)
        assert (robot.yaw_deg, robot.rest_rad) == (before.yaw_deg, XARM7.rest_rad)
    assert task.module is default_task.module and task.objects == default_task.objects


def test_each_arm_may_be_another_robot() -> None:
    task = task_of("task=two_robots_stack_cube", "robot=[panda,xarm7]")
    assert task.name == "two_robots_stack_cube-panda-xarm7"
    assert [robot.model.name for robot in task.robots] == ["panda", "xarm7"]
    assert task.robots[0] == read_task("two_robots_stack_cube").robots[0]


@pytest.mark.parametrize("robot", ["robot=panda", "robot=[panda,panda]"])
def test_a_task_with_its_own_robots_is_unchanged(robot: str) -> None:
    assert plain(task_of("task=lift_barrier", robot).identity) == plain(task_of("task=lift_barrier").identity)
    assert task_of("task=lift_barrier", robot).name == "lift_barrier"


def test_a_posture_of_another_robot_is_not_kept() -> None:
    assert read_task("take_photo").robots[0].rest_rad != DEFAULT.rest_rad
    assert {robot.rest_rad for robot in task_of("task=take_photo", "robot=xarm7").robots} == {XARM7.rest_rad}


def test_a_task_with_other_robots_is_found_by_name_and_by_store() -> None:
    task = named_task("ring_2x1-xarm7")
    assert task is not None and {robot.model for robot in task.robots} == {XARM7}
    task = named_task("two_robots_stack_cube-panda-xarm7")
    assert task is not None and task == task_of("task=two_robots_stack_cube", "robot=[panda,xarm7]")
    assert stored_task({"task": task.name, "scene": plain(task.identity)}) == task


def test_a_robot_can_be_chosen_in_the_configuration_of_its_arm() -> None:
    task = task_of("task=two_robots_stack_cube", "+task.two_robots_stack_cube.robots.1.model=xarm7")
    assert [robot.model.name for robot in task.robots] == ["panda", "xarm7"]


@pytest.mark.parametrize(
    ("robot", "message"),
    [
        ("ur7", r"task 'lift_barrier': unknown robot 'ur7'; available: panda, ur5, xarm7"),
        ("7", r"task 'lift_barrier': unknown robot '7'; available"),
        ("[panda,ur5,ur5]", r"robot is \['panda', 'ur5', 'ur5'\]; expected one for all arms, or a list of 2"),
        ("[]", r"robot is \[\]; expected one for all arms, or a list of 2"),
    ],
)
def test_unknown_robots_are_refused_before_any_work(robot: str, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        task_of("task=lift_barrier", f"robot={robot}")
    with pytest.raises(ArgumentError, match="unknown robot 'ur7'"):
        named_task("pick_meat-ur7")


def test_the_package_has_three_robots() -> None:
    assert [robot.name for robot in known_robots()] == ["panda", "xarm7", "ur5"]


@pytest.mark.parametrize("name", ["pick_meat", "two_robots_stack_cube", "lift_barrier"])
def test_a_task_with_the_xarm7_starts_clear_and_is_understood(name: str) -> None:
    task = task_of(f"task={name}", "robot=xarm7")
    scene = start_scene(task, 0)
    planning_scene = PlanningScene(task, scene)
    if len(task.agents) > 1:
        assert planning_scene.between(1, 2).distance_m > AGENT_MARGIN_M
    proposal = task.module.plan(scene, task)
    assert len(RoboChecker(task, proposal, ConstraintSet("full")).code.checks) == len(proposal.constraints)

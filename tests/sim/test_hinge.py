"""A hinged object in the simulator only turns about its axis, between its stops."""

from collections.abc import Iterator

import numpy as np
import pytest
from sapien import physx
from scipy.spatial.transform import Rotation

from rf_exp.sim import Simulator
from rf_exp.sim.objects import sapien_pose
from rf_exp.tasks import Task
from rf_exp.transforms import inverse
from rf_exp.types import CONTROL_HZ
from tests.conftest import read_task

OFF_AXIS_M, OFF_AXIS_DEG = 2e-4, 0.1
SIDEWAYS_N, TWISTING_N_M = (0.0, 2.0, 0.0), (-1.5, 0.0, 0.0)


@pytest.fixture(scope="module")
def task() -> Task:
    return read_task("three_robots_place_shoes")


@pytest.fixture(scope="module")
def world(task: Task) -> Iterator[Simulator]:
    with Simulator(task, render=False) as world:
        yield world


def released_deg(task: Task, world: Simulator, seconds: float, from_deg: float) -> list[float]:
    """The angle of the lid (deg) in each control step after its release at `from_deg`."""
    scene, angles_deg = world.reset(0), []
    pose = task.hinged_poses("lid", scene.poses, np.deg2rad(from_deg))
    world._loaded.bodies["lid"].set_pose(sapien_pose(pose))
    for _ in range(round(seconds * CONTROL_HZ)):
        scene = world.step(world.command)
        angles_deg.append(float(np.rad2deg(task.hinge_rad("lid", scene.poses))))
    return angles_deg


@pytest.mark.slow
def test_a_wide_open_lid_stays_open_and_a_falling_lid_closes_in_time(task: Task, world: Simulator) -> None:
    hinge = task.asset("lid").hinge
    assert hinge is not None
    open_deg = released_deg(task, world, 1.0, hinge.open_deg)
    assert np.ptp(open_deg) < 0.05 and open_deg[-1] == pytest.approx(hinge.open_deg, abs=0.05)
    falling_deg = released_deg(task, world, hinge.falls_s, hinge.falls_deg)
    assert abs(falling_deg[-1]) < np.rad2deg(task.success["shut_rad"]) and min(falling_deg) > -0.3


@pytest.mark.slow
def test_a_pushed_lid_stays_on_its_axis(task: Task, world: Simulator) -> None:
    start = world.reset(0)
    lid = world._loaded.bodies["lid"]
    body = lid.find_component_by_type(physx.PhysxRigidDynamicComponent)
    assert isinstance(body, physx.PhysxRigidDynamicComponent)
    for _ in range(100):
        body.add_force_at_point(list(SIDEWAYS_N), lid.pose.p)
        body.add_force_torque([0.0, 0.0, 0.0], list(TWISTING_N_M))
        world._loaded.physics.step()
        pose = lid.pose.to_transformation_matrix().astype(float)
        hinge_rad = task.hinge_rad("lid", {**start.poses, "lid": pose})
        expected = task.hinged_poses("lid", start.poses, hinge_rad)
        error = inverse(expected) @ pose
        assert np.abs(error[:3, 3]).max() < OFF_AXIS_M
        assert np.rad2deg(Rotation.from_matrix(error[:3, :3]).magnitude()) < OFF_AXIS_DEG

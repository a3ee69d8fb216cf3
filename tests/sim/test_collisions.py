"""For every task: no link of one arm passes through another arm, and no gripper through an object."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, product

import numpy as np
import pytest
import sapien
from sapien import physx

from rf_exp.geometry import PlanningScene
from rf_exp.robots import DEFAULT
from rf_exp.sim import Simulator
from rf_exp.tasks import Task
from tests.conftest import TASKS, read_task

GRIPPER = ("panda_hand", "panda_leftfinger", "panda_rightfinger")


@pytest.fixture(scope="module", params=TASKS)
def simulator(request: pytest.FixtureRequest) -> Iterator[Simulator]:
    with Simulator(read_task(request.param), render=False) as simulator:
        yield simulator


def link_of(robot: physx.PhysxArticulation, name: str) -> physx.PhysxArticulationLinkComponent:
    return next(link for link in robot.links if link.name.endswith(name))


def centre_m(link: physx.PhysxArticulationLinkComponent, name: str) -> np.ndarray:
    """Centre of mass (3,) of the hull of a link, in the world frame."""
    pose = link.entity_pose.to_transformation_matrix()
    return pose[:3, :3] @ DEFAULT.hulls[name].center_mass + pose[:3, 3]


def collide(simulator: Simulator, agent: int, shift_m: np.ndarray, bodies: set) -> bool:
    """Whether PhysX reports that two bodies overlap, one step after an arm was moved with its base.

    It reports no contact between bodies that may pass through each other.
    """
    loaded = simulator._loaded
    robot, root_pose = loaded.robots[agent - 1], loaded.robots[agent - 1].root_pose
    robot.set_root_pose(sapien.Pose((root_pose.p + shift_m).tolist(), root_pose.q.tolist()))
    loaded.physics.step()
    contacts = [contact for contact in loaded.physics.get_contacts() if set(contact.bodies) == bodies]
    robot.set_root_pose(root_pose)
    for arm, qpos in zip(loaded.robots, simulator._env.start.qpos, strict=True):  # the hit arm was thrown off
        arm.set_qpos(qpos.astype(np.float32))
        arm.set_qvel(np.zeros(len(qpos), np.float32))
    return any(point.separation < 0 for contact in contacts for point in contact.points)


@pytest.mark.slow
def test_every_two_links_of_two_arms_collide(simulator: Simulator) -> None:
    """Any two links that overlap push each other apart; only the fixed bases never meet."""
    missing = []
    for a, b in combinations(range(len(simulator.task.robots)), 2):
        simulator.reset(0)
        for name, other in product(DEFAULT.links, DEFAULT.links):
            if (name, other) == (DEFAULT.links[0], DEFAULT.links[0]):
                continue
            robots = simulator._loaded.robots
            link, moved_link = link_of(robots[a], name), link_of(robots[b], other)
            shift_m = centre_m(link, name) - centre_m(moved_link, other)
            if not collide(simulator, b + 1, shift_m, {link, moved_link}):
                missing.append(f"{name} of Agent_{a + 1} and {other} of Agent_{b + 1}")
    assert not missing


@pytest.mark.slow
def test_every_gripper_collides_with_every_object(simulator: Simulator) -> None:
    missing = []
    for agent, thing, name in product(simulator.task.agents, simulator.task.objects, GRIPPER):
        asset = simulator.task.asset(thing)
        if not asset.hulls:  # a mark on the table
            continue
        simulator.reset(0)
        robot = simulator._loaded.robots[agent - 1]
        link = link_of(robot, name)
        body = simulator._loaded.bodies[thing].find_component_by_type(physx.PhysxRigidBaseComponent)
        pose = simulator._loaded.bodies[thing].pose.to_transformation_matrix()
        shift_m = pose[:3, :3] @ asset.hulls[0].center_mass + pose[:3, 3] - centre_m(link, name)
        if not collide(simulator, agent, shift_m, {link, body}):
            missing.append(f"{name} of Agent_{agent} and {thing}")
    assert not missing


def test_two_grippers_driven_together_stop_at_each_other(lift_barrier: Task) -> None:
    """Two arms face each other, lean forward until their grippers meet, and continue pushing."""
    bases = (replace(lift_barrier.robots[0], x_m=-0.68, y_m=0.0, yaw_deg=0.0),)
    bases += (replace(lift_barrier.robots[1], x_m=0.68, y_m=0.0, yaw_deg=180.0),)
    task = replace(lift_barrier, robots=bases)
    with Simulator(task, render=False) as simulator:
        scene, command = simulator.reset(0), simulator.command
        hardest_n, deepest_m = 0.0, 0.0
        for _ in range(80):
            command[:, 3] += 0.01  # rad: the elbows stretch
            scene = simulator.step(command)
            hardest_n = max([hardest_n, *(force for _, _, force in scene.arm_contacts)])
            deepest_m = min(deepest_m, PlanningScene(task, scene).between(1, 2).distance_m)
    assert hardest_n > 20.0
    assert deepest_m > -0.002

"""Properties of the simulation for every task, without pictures."""

import hashlib
import json
import os
import subprocess
import sys
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from rf_exp.errors import ArgumentError
from rf_exp.robots import DEFAULT, Arm
from rf_exp.sim import Simulator
from rf_exp.tasks import CameraSpec, RobotSpec, Task
from rf_exp.transforms import transform
from rf_exp.types import GRIPPER_CLOSED, Scene

TWO_SECONDS = 40


def random_walk(simulator: Simulator, seed: int, steps: int = 30) -> Scene:
    """Arms that move down at random into the objects, reproducibly for a seed."""
    rng = np.random.default_rng(seed)
    simulator.reset(seed)
    action = simulator.command
    for step in range(steps):
        action[:, :7] += rng.normal(0.0, 0.02, action[:, :7].shape) + np.array([0, 0.03, 0, 0, 0, 0, 0])
        action[:, 7] = 1.0 if step % 20 < 10 else GRIPPER_CLOSED
        scene = simulator.step(action)
    return scene


def digest(simulator: Simulator, scene: Scene) -> str:
    """SHA-256 of the measured state, and of the pictures if there are any."""
    sha = hashlib.sha256()
    for array in (scene.qpos, scene.qvel, *scene.poses.values()):
        sha.update(np.ascontiguousarray(array).tobytes())
    sha.update(repr((scene.speeds, scene.held, scene.arm_contacts)).encode())
    for picture in simulator.images().values() if simulator.cameras else ():
        sha.update(np.ascontiguousarray(picture).tobytes())
    return sha.hexdigest()


def digest_in_other_process(task: Task, seed: int, *, render: bool) -> str:
    """The same digest, computed in another process."""
    return digests_in_other_process(seed, render)[task.name]


@cache
def digests_in_other_process(seed: int, render: bool) -> dict[str, str]:
    """Digests of all tasks, computed in a process that handles them in the opposite order."""
    code = (
        "import json\n"
        "from tests.conftest import TASKS, read_task\n"
        "from tests.sim.test_simulator import digest, random_walk\n"
        "from rf_exp.sim import Simulator\n"
        "found = {}\n"
        "for name in reversed(TASKS):\n"
        f"    with Simulator(read_task(name), render={render}) as simulator:\n"
        f"        found[name] = digest(simulator, random_walk(simulator, {seed}))\n"
        "print(json.dumps(found))\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout.splitlines()[-1])


def worst_overlap_m(simulator: Simulator) -> float:
    """The deepest overlap of any two bodies in the current contacts of PhysX."""
    contacts = simulator._loaded.physics.get_contacts()
    return max((-point.separation for contact in contacts for point in contact.points), default=0.0)


@pytest.mark.slow
def test_a_start_is_at_rest_and_stays_so_while_the_arms_hold(task: Task) -> None:
    with Simulator(task, render=False) as simulator:
        for seed in range(3):
            start = simulator.reset(seed)
            assert not start.qvel.any() and not any(start.speeds.values())
            np.testing.assert_allclose(start.qpos, task.start(seed).qpos, atol=1e-6)
            hold = simulator.command
            for _ in range(TWO_SECONDS):
                scene = simulator.step(hold)
                assert max(scene.speeds.values()) < 2e-3
                assert scene.held == (None,) * len(task.robots) and not scene.arm_contacts
                assert worst_overlap_m(simulator) < 5e-4
            assert np.abs(scene.qpos[:, :7] - hold[:, :7]).max() < 1e-3
            for name, pose in start.poses.items():
                np.testing.assert_allclose(scene.poses[name], pose, atol=5e-4, err_msg=name)
            assert scene.step == TWO_SECONDS


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes_whatever_ran_before(task: Task) -> None:
    with Simulator(task, render=False) as simulator:
        first = digest(simulator, random_walk(simulator, 5))
        other = digest(simulator, random_walk(simulator, 6))
        again = digest(simulator, random_walk(simulator, 5))
    assert first == again == digest_in_other_process(task, 5, render=False)
    assert first != other


def test_the_random_walk_touches_the_objects(lift_barrier: Task) -> None:
    with Simulator(lift_barrier, render=False) as simulator:
        start = simulator.reset(5)
        scene = random_walk(simulator, 5)
    assert np.abs(scene.poses["barrier"] - start.poses["barrier"]).max() > 1e-3


def test_commands_equal_those_of_maniskills_controller(lift_barrier: Task) -> None:
    rng = np.random.default_rng(0)
    with Simulator(lift_barrier, render=False) as simulator, Simulator(lift_barrier, render=False) as other:
        simulator.reset(3)
        other.reset(3)
        action = simulator.command
        for _ in range(10):
            action += rng.normal(0, 0.03, action.shape)
            scene = simulator.step(action)
            keys = [f"{arm.uid}-{i}" for i, arm in enumerate(other._env.arms)]
            other._env.step({key: row.astype(np.float32) for key, row in zip(keys, action, strict=True)})
        expected = np.stack([robot.qpos for robot in other._loaded.robots])
    np.testing.assert_allclose(scene.qpos, expected, atol=1e-5)


def action_above(
    simulator: Simulator, scene: Scene, above_m: float, *, agents: tuple[int, ...] = (1, 2)
) -> NDArray:
    """The action that moves each gripper above the nearer end of the barrier."""
    action = simulator.command
    points = simulator.task.asset("barrier").points.values()
    for agent in agents:
        arm = Arm(DEFAULT, simulator.task.robots[agent - 1].world_from_base)
        grasps = [scene.poses["barrier"] @ point.object_from_tcp for point in points]
        grasp = min(grasps, key=lambda pose: np.linalg.norm(pose[:3, 3] - arm.world_from_base[:3, 3]))
        solutions = [
            arm.solve(grasp @ rotation @ transform((0, 0, -above_m)), action[agent - 1, :7])
            for rotation in (np.diag([1.0, 1, 1, 1]), np.diag([-1.0, -1, 1, 1]))
        ]
        reachable = [qpos for qpos in solutions if qpos is not None]
        action[agent - 1, :7] = min(reachable, key=lambda qpos: np.abs(qpos - action[agent - 1, :7]).max())
    return action


def move_to(simulator: Simulator, action: NDArray, steps: int = 25) -> Scene:
    """Moves the targets along a line in joint space, then waits for 6 steps."""
    start = simulator.command
    for fraction in [*np.linspace(0, 1, steps), *[1.0] * 6]:
        scene = simulator.step(start + fraction * (action - start))
    return scene


def test_two_arms_grasp_the_barrier_and_lift_it_level(lift_barrier: Task) -> None:
    with Simulator(lift_barrier, render=False) as simulator:
        start = simulator.reset(1)
        scene = move_to(simulator, action_above(simulator, start, 0.08))
        scene = move_to(simulator, action_above(simulator, start, 0.0))
        assert scene.held == (None, None)  # the fingers are around it, but open
        closed = simulator.command
        closed[:, 7] = GRIPPER_CLOSED
        scene = move_to(simulator, closed, 8)
        assert scene.held == ("barrier", "barrier")
        scene = move_to(simulator, action_above(simulator, start, 0.20), 40)
        assert scene.held == ("barrier", "barrier")
        assert 0.18 < scene.poses["barrier"][2, 3] < 0.22
        assert abs(scene.poses["barrier"][2, 0]) < np.sin(np.deg2rad(2))
        released = simulator.command
        released[0, 7] = 1.0
        assert move_to(simulator, released, 4).held == (None, "barrier")


def test_a_gripper_closed_on_air_holds_nothing(lift_barrier: Task) -> None:
    with Simulator(lift_barrier, render=False) as simulator:
        simulator.reset(0)
        closed = simulator.command
        closed[:, 7] = GRIPPER_CLOSED
        assert move_to(simulator, closed, 8).held == (None, None)


def test_arms_that_meet_are_reported_with_a_force(lift_barrier: Task) -> None:
    with Simulator(lift_barrier, render=False) as simulator:
        start = simulator.reset(0)
        above = action_above(simulator, start, 0.25)
        action = simulator.command
        for row, agent in enumerate((1, 2)):
            arm = Arm(DEFAULT, lift_barrier.robots[row].world_from_base)
            pose = arm.tcp(above[row, :7])
            pose[:2, 3] = 0.0  # both grippers at the same place
            qpos = arm.solve(pose, above[row, :7])
            assert qpos is not None, agent
            action[row, :7] = qpos
        hits = [simulator.step(action).arm_contacts for _ in range(40)]
    forces = [force for contacts in hits for a, b, force in contacts if (a, b) == (1, 2)]
    assert forces and max(forces) > 1.0


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 4])
def test_any_number_of_arms(lift_barrier: Task, count: int) -> None:
    bases = tuple(RobotSpec(x, y, 90) for x in (-0.6, 0.7) for y in (-1.0, 0.3))[:count]
    cameras = {
        name: CameraSpec((0.5, 0.1, 0.5)) for name in ("global", *(f"agent{k + 1}" for k in range(count)))
    }
    task = replace(lift_barrier, robots=bases, cameras=cameras)
    with Simulator(task, render=False) as simulator:
        start = simulator.reset(0)
        assert start.qpos.shape == (count, 9) and simulator.command.shape == (count, 8)
        action = simulator.command
        action[-1, 0] += 0.2
        scene = move_to(simulator, action)
    change = np.abs(scene.qpos - start.qpos)[:, 0]
    assert change[-1] == pytest.approx(0.2, abs=2e-3)
    assert not (change[:-1] > 1e-3).any()


@pytest.mark.parametrize(
    ("action", "message"),
    [(np.zeros((2, 7)), "action of shape (2, 7)"), (np.full((2, 8), np.nan), "values that are not finite")],
)
def test_an_invalid_action_is_refused(lift_barrier: Task, action: NDArray, message: str) -> None:
    with Simulator(lift_barrier, render=False) as simulator, pytest.raises(ArgumentError) as error:
        simulator.step(action)
    assert message in str(error.value)
    assert "expected finite numbers of shape (2, 8): joint targets in rad, gripper" in str(error.value)


@pytest.mark.parametrize("seed", [-1, 2**32])
def test_a_seed_outside_the_range_is_refused(lift_barrier: Task, seed: int) -> None:
    with Simulator(lift_barrier, render=False) as simulator, pytest.raises(ArgumentError) as error:
        simulator.reset(seed)
    assert str(error.value) == f"seed {seed}: expected a whole number from 0 to 4294967295"


def test_a_picture_without_pixels_is_refused(lift_barrier: Task) -> None:
    with pytest.raises(ArgumentError, match=r"^height_px=0: expected 1 pixel or more$"):
        Simulator(lift_barrier, height_px=0, render=False)


def test_pictures_of_a_simulator_without_rendering_are_refused(lift_barrier: Task) -> None:
    with Simulator(lift_barrier, render=False) as simulator:
        assert simulator.cameras == () and simulator.camera_models() == {}
        with pytest.raises(ArgumentError) as error:
            simulator.images()
    assert str(error.value) == "a simulator made with render=False draws no pictures; expected render=True"


def without_vulkan(render: bool) -> subprocess.CompletedProcess[str]:
    code = (
        "from tests.conftest import read_task\n"
        "from rf_exp.errors import StageError\n"
        "from rf_exp.sim import Simulator\n"
        "try:\n"
        f"    simulator = Simulator(read_task('lift_barrier'), render={render})\n"
        "    print('step', simulator.step(simulator.command).step)\n"
        "except StageError as error:\n"
        "    print('StageError', error)\n"
    )
    environment = {**os.environ, "VK_DRIVER_FILES": "/nonexistent", "VK_ICD_FILENAMES": "/nonexistent"}
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)


@pytest.mark.slow
def test_states_are_simulated_on_a_machine_without_vulkan() -> None:
    run = without_vulkan(render=False)
    assert run.stdout.split() == ["step", "1"], run.stderr


@pytest.mark.slow
def test_pictures_on_a_machine_without_vulkan_stop_before_any_work() -> None:
    run = without_vulkan(render=True)
    assert run.stdout.startswith("StageError rendering was requested, but SAPIEN has no Vulkan device"), (
        run.stderr
    )
    assert "render=false" in run.stdout

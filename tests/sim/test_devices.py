"""Simulated inaccuracies of sensors and actuators, and varied poses of arms and cameras."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from rf_exp.sim import Simulator
from rf_exp.tasks import NO_VARIATION, SuccessEvaluator, Variation
from rf_exp.types import Scene, joints_of
from tests.conftest import read_task

SEED = 5
CLEAN = read_task("lift_barrier")


def joints_and_commands(variation: Variation, steps: int = 12) -> tuple[NDArray, NDArray]:
    """Measured joints (T + 1, N, 7) and commands (T, N, 8) of arms that move by constant increments."""
    with Simulator(replace(CLEAN, variation=variation), render=False) as world:
        measured, commands = [world.reset(SEED).qpos[:, :7]], []
        for _ in range(steps):
            commands.append(world.command + np.array([0, 0.02, 0, 0.02, 0, 0, 0, 0]))
            measured.append(world.step(commands[-1]).qpos[:, :7])
    return np.stack(measured), np.stack(commands)


def test_delayed_commands_are_executed_later() -> None:
    exact, _ = joints_and_commands(NO_VARIATION)
    late, commands = joints_and_commands(Variation("late", delay_s=(0.15, 0.15)))
    np.testing.assert_allclose(late[:3], late[:1].repeat(3, axis=0), atol=1e-4)  # no motion yet
    np.testing.assert_allclose(late[3:], exact[:-3], atol=1e-4)
    assert (np.diff(commands[:, :, 1], axis=0) > 0).all()  # commands are those given, not the delayed ones


def impaired_index(variation: Variation) -> int:
    """The index of the impaired arm."""
    device = replace(CLEAN, variation=variation).start(SEED).devices.impaired
    assert device is not None
    return device.agent - 1


def test_only_one_arm_is_late() -> None:
    variation = Variation("late_arm", arm_delay_s=0.2)
    (exact, _), (late, _), index = (
        joints_and_commands(NO_VARIATION),
        joints_and_commands(variation),
        impaired_index(variation),
    )
    np.testing.assert_allclose(late[4:, index], exact[:-4, index], atol=1e-4)
    np.testing.assert_allclose(late[:, 1 - index], exact[:, 1 - index], atol=1e-6)


def test_only_one_arm_is_slow() -> None:
    """It is commanded by 0.02 rad per step, and follows by 0.01."""
    variation = Variation("slow_arm", arm_speed_rad_s=0.2)
    (exact, _), (slow, _), index = (
        joints_and_commands(NO_VARIATION),
        joints_and_commands(variation),
        impaired_index(variation),
    )
    travel = slow[-1, index, [1, 3]] - slow[0, index, [1, 3]]
    np.testing.assert_allclose(travel, (exact[-1, index, [1, 3]] - exact[0, index, [1, 3]]) / 2, rtol=0.1)
    np.testing.assert_allclose(slow[:, 1 - index], exact[:, 1 - index], atol=1e-6)


@pytest.mark.render
def test_only_the_camera_of_one_agent_is_dark() -> None:
    variation = Variation("dark_camera", camera_dark=True)
    with Simulator(replace(CLEAN, variation=variation), width_px=32, height_px=24) as world:
        world.reset(SEED)
        bright = {name: picture.max() > 0 for name, picture in world.images().items()}
    assert [name for name, seen in bright.items() if not seen] == [f"agent{impaired_index(variation) + 1}"]


def test_joints_with_encoder_offsets_follow_their_measured_positions() -> None:
    variation = Variation("encoders", joint_offset_deg=2.0)
    exact, _ = joints_and_commands(NO_VARIATION)
    measured, commands = joints_and_commands(variation)
    offset = np.array(replace(CLEAN, variation=variation).start(SEED).devices.joint_offset_rad)
    assert 0.01 < np.abs(offset).max() < np.deg2rad(2)
    np.testing.assert_allclose(measured, exact + offset, atol=1e-9)
    np.testing.assert_allclose(measured[-1], commands[-1][:, :7], atol=0.05)


def test_success_is_judged_by_true_joints(monkeypatch: pytest.MonkeyPatch) -> None:
    task = replace(CLEAN, variation=Variation("encoders", joint_offset_deg=2.0))
    start, evaluated = task.start(SEED), list[Scene]()
    with Simulator(task, render=False) as world:
        scene = world.reset(SEED)
        conditions = task.module.conditions
        monkeypatch.setattr(
            task.module,
            "conditions",
            lambda now, *arguments: evaluated.append(now) or conditions(now, *arguments),
        )
        SuccessEvaluator(world.task, scene)(scene)
    offset = np.array(start.devices.joint_offset_rad)
    np.testing.assert_allclose(joints_of(scene.qpos) - joints_of(evaluated[0].qpos), offset, atol=1e-12)
    np.testing.assert_allclose(evaluated[0].qpos, start.qpos, atol=1e-6)
    assert evaluated[0].with_true_joints is evaluated[0]


def test_arms_have_their_sampled_poses() -> None:
    varied = replace(
        CLEAN, variation=Variation("x", table_height_m=(0.02, 0.02), base_position_m=0.05, base_yaw_deg=5.0)
    )
    with Simulator(varied, render=False) as world:
        world.reset(SEED)
        assert world.task == varied.in_scene(SEED) != varied
        bases = [robot.pose.sp.to_transformation_matrix() for robot in (a.robot for a in world._env.arms)]
        for pose, robot in zip(bases, varied.in_scene(SEED).robots, strict=True):
            np.testing.assert_allclose(pose, robot.world_from_base, atol=1e-6)
            assert robot.z_m == pytest.approx(-0.02)
        world.reset(SEED + 1)
        assert world.task == varied.in_scene(SEED + 1)


@pytest.mark.render
def test_cameras_have_their_sampled_poses() -> None:
    """Rays of the camera model meet the table at the measured depth."""
    varied = replace(
        CLEAN, variation=Variation("cameras", camera_position_m=0.05, camera_direction_deg=(0.0, 5.0))
    )
    with Simulator(varied, width_px=128, height_px=96) as world:
        world.reset(SEED)
        models, depth, bodies = world.camera_models(), world.depth(), world.segmentation()
        for name, spec in varied.in_scene(SEED).cameras.items():
            pose = models[name].world_from_camera
            np.testing.assert_array_equal(pose, spec.world_from_camera)
            rows, columns = np.nonzero(bodies[name] == world.bodies()["table"][0])
            pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))])
            # 1 m long along the optical axis.
            rays = pose[:3, :3] @ np.linalg.inv(models[name].intrinsics) @ pixels
            distance_m = -pose[2, 3] / rays[2]
            points = pose[:3, 3:] + rays * distance_m
            on_table = (rays[2] < 0) & (np.abs(points[:2]) < 0.8).all(axis=0)
            error_m = np.abs(depth[name][rows, columns] - distance_m)[on_table]
            assert on_table.sum() > 1000 and np.quantile(error_m, 0.99) < 0.004


@pytest.mark.render
def test_noise_and_exposure_of_pictures_are_reproducible() -> None:
    with Simulator(CLEAN, width_px=64, height_px=48) as world:
        world.reset(SEED)
        clean = world.images()
    noisy = replace(CLEAN, variation=Variation("noise", exposure=0.3, pixel_noise=10.0))
    gain = noisy.start(SEED).devices.gain
    with Simulator(noisy, width_px=64, height_px=48) as world:
        world.reset(SEED)
        pictures, again = world.images(), world.images(["agent2"])
        np.testing.assert_array_equal(pictures["agent2"], again["agent2"])
        for name, picture in pictures.items():
            exposed = clean[name] * gain
            noise = (picture - exposed)[(exposed > 40) & (exposed < 215)]
            assert len(noise) > 2000 and abs(noise.mean()) < 0.7 and 9.5 < noise.std() < 10.5
        world.step(world.command)
        assert (world.images()["agent2"] != pictures["agent2"]).mean() > 0.5  # another frame has other noise
        world.reset(SEED)
        np.testing.assert_array_equal(world.images()["agent2"], pictures["agent2"])


@pytest.mark.render
def test_a_share_of_frames_flickers() -> None:
    varied = replace(CLEAN, variation=Variation("flicker", flicker=0.3))
    with Simulator(varied, width_px=32, height_px=24) as world:
        world.reset(SEED)
        means = []
        for _ in range(60):
            means.append(world.images(["global"])["global"].mean())
            world.step(world.command)
    relative = np.array(means) / np.median(means)
    flickers = np.abs(relative - 1) > 0.005
    assert 8 <= flickers.sum() <= 28 and np.abs(relative - 1).max() < 0.11

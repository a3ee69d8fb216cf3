"""Sensors and actuators that are not exact, and arms and cameras that stand otherwise, in simulation."""

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


def moved(variation: Variation, steps: int = 12) -> tuple[NDArray, NDArray]:
    """Measured joints (T + 1, N, 7) and commands (T, N, 8) of arms that are sent on by the same amounts."""
    with Simulator(replace(CLEAN, variation=variation), render=False) as world:
        found, commands = [world.reset(SEED).qpos[:, :7]], []
        for _ in range(steps):
            commands.append(world.command + np.array([0, 0.02, 0, 0.02, 0, 0, 0, 0]))
            found.append(world.step(commands[-1]).qpos[:, :7])
    return np.stack(found), np.stack(commands)


def test_commands_that_are_late_are_carried_out_as_many_steps_later() -> None:
    exact, _ = moved(NO_VARIATION)
    late, commands = moved(Variation("late", delay_s=(0.15, 0.15)))
    np.testing.assert_allclose(late[:3], late[:1].repeat(3, axis=0), atol=1e-4)  # it stands still as yet
    np.testing.assert_allclose(late[3:], exact[:-3], atol=1e-4)
    assert (np.diff(commands[:, :, 1], axis=0) > 0).all()  # what was commanded is told, not what is under way


def impaired(variation: Variation) -> int:
    """The row of the arm that is drawn."""
    found = replace(CLEAN, variation=variation).start(SEED).devices.impaired
    assert found is not None
    return found.agent - 1


def test_one_arm_alone_is_late() -> None:
    variation = Variation("late_arm", arm_delay_s=0.2)
    (exact, _), (late, _), row = moved(NO_VARIATION), moved(variation), impaired(variation)
    np.testing.assert_allclose(late[4:, row], exact[:-4, row], atol=1e-4)
    np.testing.assert_allclose(late[:, 1 - row], exact[:, 1 - row], atol=1e-6)


def test_one_arm_alone_is_slow() -> None:
    """It is sent on by 0.02 rad a step, and follows by 0.01."""
    variation = Variation("slow_arm", arm_speed_rad_s=0.2)
    (exact, _), (slow, _), row = moved(NO_VARIATION), moved(variation), impaired(variation)
    way = slow[-1, row, [1, 3]] - slow[0, row, [1, 3]]
    np.testing.assert_allclose(way, (exact[-1, row, [1, 3]] - exact[0, row, [1, 3]]) / 2, rtol=0.1)
    np.testing.assert_allclose(slow[:, 1 - row], exact[:, 1 - row], atol=1e-6)


@pytest.mark.render
def test_the_camera_of_one_agent_alone_is_dark() -> None:
    variation = Variation("dark_camera", camera_dark=True)
    with Simulator(replace(CLEAN, variation=variation), width_px=32, height_px=24) as world:
        world.reset(SEED)
        bright = {name: picture.max() > 0 for name, picture in world.images().items()}
    assert [name for name, seen in bright.items() if not seen] == [f"agent{impaired(variation) + 1}"]


def test_joints_that_measure_wrongly_go_where_they_believe_to_be_sent() -> None:
    variation = Variation("encoders", joint_offset_deg=2.0)
    exact, _ = moved(NO_VARIATION)
    measured, commands = moved(variation)
    offset = np.array(replace(CLEAN, variation=variation).start(SEED).devices.joint_offset_rad)
    assert 0.01 < np.abs(offset).max() < np.deg2rad(2)
    np.testing.assert_allclose(measured, exact + offset, atol=1e-9)
    np.testing.assert_allclose(measured[-1], commands[-1][:, :7], atol=0.05)


def test_judges_see_joints_as_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    task = replace(CLEAN, variation=Variation("encoders", joint_offset_deg=2.0))
    start, judged = task.start(SEED), list[Scene]()
    with Simulator(task, render=False) as world:
        scene = world.reset(SEED)
        conditions = task.module.conditions
        monkeypatch.setattr(
            task.module, "conditions", lambda now, *of: judged.append(now) or conditions(now, *of)
        )
        SuccessEvaluator(world.task, scene)(scene)
    offset = np.array(start.devices.joint_offset_rad)
    np.testing.assert_allclose(joints_of(scene.qpos) - joints_of(judged[0].qpos), offset, atol=1e-12)
    np.testing.assert_allclose(judged[0].qpos, start.qpos, atol=1e-6)
    assert judged[0].with_true_joints is judged[0]


def test_arms_stand_where_they_were_drawn() -> None:
    usual = replace(
        CLEAN, variation=Variation("x", table_height_m=(0.02, 0.02), base_position_m=0.05, base_yaw_deg=5.0)
    )
    with Simulator(usual, render=False) as world:
        world.reset(SEED)
        assert world.task == usual.in_scene(SEED) != usual
        bases = [robot.pose.sp.to_transformation_matrix() for robot in (a.robot for a in world._env.arms)]
        for found, robot in zip(bases, usual.in_scene(SEED).robots, strict=True):
            np.testing.assert_allclose(found, robot.world_from_base, atol=1e-6)
            assert robot.z_m == pytest.approx(-0.02)
        world.reset(SEED + 1)
        assert world.task == usual.in_scene(SEED + 1)


@pytest.mark.render
def test_cameras_see_from_where_they_were_drawn() -> None:
    """Rays of the camera's model meet the table where its depth says."""
    usual = replace(
        CLEAN, variation=Variation("cameras", camera_position_m=0.05, camera_direction_deg=(0.0, 5.0))
    )
    with Simulator(usual, width_px=128, height_px=96) as world:
        world.reset(SEED)
        models, depth, bodies = world.camera_models(), world.depth(), world.segmentation()
        for name, spec in usual.in_scene(SEED).cameras.items():
            pose = models[name].world_from_camera
            np.testing.assert_array_equal(pose, spec.world_from_camera)
            rows, columns = np.nonzero(bodies[name] == world.bodies()["table"][0])
            pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))])
            rays = pose[:3, :3] @ np.linalg.inv(models[name].intrinsics) @ pixels  # a metre along the view
            far_m = -pose[2, 3] / rays[2]
            at = pose[:3, 3:] + rays * far_m
            on_table = (rays[2] < 0) & (np.abs(at[:2]) < 0.8).all(axis=0)
            off_m = np.abs(depth[name][rows, columns] - far_m)[on_table]
            assert on_table.sum() > 1000 and np.quantile(off_m, 0.99) < 0.004


@pytest.mark.render
def test_pictures_are_noisy_and_of_their_exposure_each_time_alike() -> None:
    with Simulator(CLEAN, width_px=64, height_px=48) as world:
        world.reset(SEED)
        clean = world.images()
    noisy = replace(CLEAN, variation=Variation("noise", exposure=0.3, pixel_noise=10.0))
    gain = noisy.start(SEED).devices.gain
    with Simulator(noisy, width_px=64, height_px=48) as world:
        world.reset(SEED)
        seen, again = world.images(), world.images(["agent2"])
        np.testing.assert_array_equal(seen["agent2"], again["agent2"])
        for name, picture in seen.items():
            exposed = clean[name] * gain
            off = (picture - exposed)[(exposed > 40) & (exposed < 215)]
            assert len(off) > 2000 and abs(off.mean()) < 0.7 and 9.5 < off.std() < 10.5
        world.step(world.command)
        assert (world.images()["agent2"] != seen["agent2"]).mean() > 0.5  # another frame has other noise
        world.reset(SEED)
        np.testing.assert_array_equal(world.images()["agent2"], seen["agent2"])


@pytest.mark.render
def test_one_frame_in_so_many_flickers() -> None:
    usual = replace(CLEAN, variation=Variation("flicker", flicker=0.3))
    with Simulator(usual, width_px=32, height_px=24) as world:
        world.reset(SEED)
        means = []
        for _ in range(60):
            means.append(world.images(["global"])["global"].mean())
            world.step(world.command)
    relative = np.array(means) / np.median(means)
    flickers = np.abs(relative - 1) > 0.005
    assert 8 <= flickers.sum() <= 28 and np.abs(relative - 1).max() < 0.11
